"""Do laws hold for whatever numbers a search finds? Few examples, the same in every run."""

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from torch.nn.functional import normalize

from torchprt import brdf, light, sh
from torchprt.pose import nearest_rotation

pytestmark = pytest.mark.usefixtures("untyped")
EPS = 2.0**-52
few = settings(max_examples=25, derandomize=True, deadline=None, database=None)

# Numbers of every size, and those beside which others vanish.
component = st.one_of(st.floats(-1, 1), st.sampled_from([0.0, 1.0, -1.0, 1e-8, 1e-160, -1e-300, 5e-324]))
exponents = st.integers(-90, 90)
orders = st.integers(1, 9)
seeds = st.integers(0, 2**16)


@st.composite
def vectors(draw):
    made = torch.tensor([draw(component) for _ in range(3)], dtype=torch.float64)
    assume(bool(made.abs().max() > 0))
    return made


@st.composite
def directions(draw):
    made = draw(vectors())
    return normalize(made / made.abs().max(), dim=-1)


@st.composite
def rotations(draw):
    """By way of quaternions, many of them about an axis or by half a turn."""
    four = torch.tensor([draw(component) for _ in range(4)], dtype=torch.float64)
    assume(bool(four.abs().max() > 1e-3))
    w, x, y, z = normalize(four, dim=-1)
    cross = torch.stack(
        [torch.stack([0 * x, -z, y]), torch.stack([z, 0 * x, -x]), torch.stack([-y, x, 0 * x])]
    )  # fmt: skip
    return torch.eye(3).double() + 2 * w * cross + 2 * cross @ cross


def lit(order, seed):
    made = torch.randn(order**2, 3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    made[0] = made[0].abs()
    return made


@few
@given(directions(), orders)
def test_squares_of_a_band_sum_to_a_constant(direction, order):
    squares = sh.basis(direction, order).square()
    sums = torch.stack([squares[l * l : (l + 1) ** 2].sum() for l in range(order)])
    wanted = (2 * torch.arange(order).double() + 1) / (4 * torch.pi)
    torch.testing.assert_close(sums, wanted, rtol=32 * order * EPS, atol=0)


@few
@given(rotations(), rotations(), orders, seeds, exponents)
def test_turning_twice_is_turning_by_the_product_and_keeps_every_norm(one, other, order, seed, exponent):
    lamp = lit(order, seed) * 2.0**exponent
    size = 2.0**exponent * 64 * order**1.5 * EPS
    twice, once = sh.rotate(sh.rotate(lamp, one), other), sh.rotate(lamp, other @ one)
    torch.testing.assert_close(twice, once, atol=size, rtol=0)
    band = sh.bands(order)
    for l in range(order):
        torch.testing.assert_close(once[band == l].norm(), lamp[band == l].norm(), atol=4 * size, rtol=0)


@few
@given(rotations(), orders, seeds)
def test_the_two_ways_to_turn_a_light_agree(turn, order, seed):
    lamp = lit(order, seed)
    torch.testing.assert_close(
        sh.rotate(lamp, turn), sh.Rotation(order, torch.float64)(lamp, turn), atol=64 * order**1.5 * EPS, rtol=0
    )


@few
@given(orders, orders, seeds, exponents)
def test_products_commute_whatever_the_sizes(order, other, seed, exponent):
    a, b = lit(order, seed), lit(other, seed + 1) * 2.0**exponent
    one, two = sh.product(a, b), sh.product(b, a)
    torch.testing.assert_close(one, two, atol=64 * order * other * 2.0**exponent * EPS, rtol=0)


@settings(few, max_examples=6)
@given(orders, seeds, exponents)
def test_a_window_keeps_the_mean_and_does_not_see_the_brightness(order, seed, exponent):
    lamp = lit(min(order, 3), seed)
    for name in ("least", "auto"):
        factors = light.window_factors(lamp, name)
        assert factors[0] == 1
        assert (factors.diff() <= 0).all()
        assert torch.equal(light.window_factors(lamp * 2.0**exponent, name), factors)


@few
@given(st.integers(2, 6), seeds, exponents)
def test_the_lamp_that_stands_for_a_light_scales_with_it(order, seed, exponent):
    direction, radiance = light.dominant(lit(order, seed))
    again, scaled = light.dominant(lit(order, seed) * 2.0**exponent)
    assert torch.equal(again, direction)
    torch.testing.assert_close(scaled, radiance * 2.0**exponent, rtol=4 * EPS, atol=0)


@few
@given(vectors(), exponents)
def test_what_is_brought_to_the_horizon_is_a_unit_vector_of_the_upper_half(vector, exponent):
    # Denormal numbers have lost digits already.
    assume(float(vector.abs().max()) > 1e-270)
    found = sh.to_horizon(vector)
    assert abs(float(found.norm()) - 1) <= 4 * EPS
    assert found[2] >= 0
    torch.testing.assert_close(sh.to_horizon(found), found, atol=2 * EPS, rtol=0)
    torch.testing.assert_close(sh.to_horizon(vector * 2.0**exponent), found, atol=2 * EPS, rtol=0)


@few
@given(st.lists(component, min_size=9, max_size=9), exponents)
def test_whatever_matrix_it_is_the_nearest_rotation_is_proper(numbers, exponent):
    matrix = torch.tensor(numbers, dtype=torch.float64).reshape(3, 3) * 2.0**exponent
    found = nearest_rotation(matrix)
    torch.testing.assert_close(found @ found.T, torch.eye(3).double(), atol=1e-12, rtol=0)
    assert torch.linalg.det(found) > 0.99


@few
@given(directions(), directions(), st.sampled_from(["phong:1", "phong:1e4", "blinn:50", "ggx:0.05", "ward:0.1,0.4"]))
def test_light_and_eye_may_be_exchanged(one, other, spec):
    model = brdf.parse(spec)
    up = torch.tensor([1.0, 1.0, -1.0]).double()
    one, other = (torch.where(each[2] < 0, each * up, each) for each in (one, other))
    there, back = model(one, other), model(other, one)
    assert there >= 0
    # A power of 1e4 turns an epsilon of the cosine into 1e4.
    torch.testing.assert_close(there, back, rtol=1e5 * EPS, atol=1e-300)


@few
@given(st.floats(0, 1e6), orders)
def test_a_phong_lobe_has_unit_mean_and_falls_from_band_to_band(exponent, order):
    bands = sh.phong(exponent, order)
    assert bands[0] == 1
    assert (bands.abs() <= 1).all()
    # Up to the exponent; beyond it the signs alternate.
    falling = bands[: int(min(exponent, order)) + 1]
    assert (falling.diff() <= 0).all()


@few
@given(st.floats(1e-12, torch.pi), st.floats(1e-12, torch.pi), orders)
def test_a_wider_cap_is_brighter_and_no_band_exceeds_the_mean(narrow, wide, order):
    narrow, wide = sorted((narrow, wide))
    less, more = sh.disc(narrow, order), sh.disc(wide, order)
    assert less[0] <= more[0]
    assert (more.abs() <= more[0] * (1 + 8 * order * EPS)).all()
