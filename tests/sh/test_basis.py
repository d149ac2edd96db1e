import math

import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError

EPS = {torch.float32: 2**-23, torch.float64: 2**-52}


@pytest.mark.parametrize("order", [0, -1])
def test_refuses_an_order_below_one(order):
    with pytest.raises(InputError, match="order must be at least 1"):
        sh.basis(torch.zeros(1, 3), order)


@pytest.mark.parametrize("count", [0, 2, 3, 8, 24, -4])
def test_refuses_a_count_of_coefficients_that_is_not_square(count):
    with pytest.raises(InputError, match="square"):
        sh.order_of(count)


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0], [0.0, 0.0, 1.001], [math.nan, 0.0, 1.0], [math.inf, 0.0, 0.0]])
def test_refuses_directions_that_are_not_of_unit_length(bad):
    with pytest.raises(InputError, match="normals must be finite and of unit length"):
        sh.check_directions(torch.tensor([[0.0, 0.0, 1.0], bad]), "normals")


def test_takes_unit_directions_and_none_at_all():
    sh.check_directions(torch.tensor([[0.6, 0.0, 0.8]]))
    sh.check_directions(torch.zeros(0, 3))
    assert sh.basis(torch.zeros(0, 3), 3).shape == (0, 9)
    assert sh.basis(torch.zeros(2, 0, 3, dtype=torch.float64, requires_grad=True), 3).shape == (2, 0, 9)


def test_has_the_constants_and_signs_of_the_papers():
    x, y, z = s = torch.tensor([0.48, 0.6, 0.64], dtype=torch.float64)
    expected = torch.stack(
        [
            torch.tensor(0.282095, dtype=torch.float64),
            -0.488603 * y,
            0.488603 * z,
            -0.488603 * x,
            1.092548 * x * y,
            -1.092548 * y * z,
            0.315392 * (3 * z * z - 1),
            -1.092548 * x * z,
            0.546274 * (x * x - y * y),
        ]
    )
    # The constants are printed to six digits.
    torch.testing.assert_close(sh.basis(s, 3), expected, atol=1e-6, rtol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", [1, 2, 3, 6, 33])
def test_with_and_without_gradients_give_the_same_values(order, dtype):
    directions, _ = sh.fibonacci(301, dtype)
    plain = sh.basis(directions, order)
    traced = sh.basis(directions.clone().requires_grad_(), order)
    # The two forms round in different places (fused multiply-add): a few eps of the largest value, a band.
    torch.testing.assert_close(traced.detach(), plain, atol=4 * order**1.5 * EPS[dtype], rtol=0)


def test_is_a_view_with_components_first_in_memory():
    assert sh.basis(sh.fibonacci(50)[0], 4).movedim(-1, 0).is_contiguous()
    batch = sh.basis(sh.fibonacci(50)[0].reshape(5, 10, 3), 4)
    assert batch.shape == (5, 10, 16)
    torch.testing.assert_close(batch.reshape(50, 16), sh.basis(sh.fibonacci(50)[0], 4), atol=0, rtol=0)


@pytest.mark.parametrize("order", [1, 2, 6, 32])
@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_is_exact_at_the_poles(order, pole):
    value = sh.basis(torch.tensor([0.0, 0.0, pole], dtype=torch.float64), order)
    l = torch.arange(order, dtype=torch.float64)
    expected = torch.zeros(order * order, dtype=torch.float64)
    index = torch.arange(order)
    expected[index * (index + 1)] = pole**l * ((2 * l + 1) / (4 * math.pi)).sqrt()
    # Only m = 0 lives at the poles; three roundings a step of the recurrence.
    torch.testing.assert_close(value, expected, atol=0, rtol=3 * order * EPS[torch.float64])


@pytest.mark.parametrize("order", [2, 6, 8])
def test_gradients_are_right_on_the_axes_and_poles_too(order):
    directions = torch.cat([torch.eye(3), -torch.eye(3), torch.tensor([[0.48, 0.6, 0.64]])]).double()
    assert torch.autograd.gradcheck(lambda d: sh.basis(d, order), directions.requires_grad_())


def test_second_gradients_are_right():
    directions = torch.tensor([[0.0, 0.0, 1.0], [0.48, 0.6, 0.64]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradgradcheck(lambda d: sh.basis(d, 4), directions)


def test_function_transforms_see_through_it(untyped):
    directions, _ = sh.fibonacci(7)
    each = torch.func.vmap(lambda d: sh.basis(d, 4))(directions)
    torch.testing.assert_close(each, sh.basis(directions, 4))
    tangent = torch.ones_like(directions)
    _, slope = torch.func.jvp(lambda d: sh.basis(d, 4), (directions,), (tangent,))
    step = 1e-6
    difference = (sh.basis(directions + step * tangent, 4) - sh.basis(directions - step * tangent, 4)) / (2 * step)
    # Central differences lose half of the digits.
    torch.testing.assert_close(slope, difference, atol=1e-8, rtol=1e-7)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_reconstruction_is_the_sum_of_basis_functions(count):
    directions, _ = sh.fibonacci(20)
    light = torch.randn((*(2, 5)[:count], 9, 3), dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    expected = (sh.basis(directions, 3).unsqueeze(-1) * light.unsqueeze(-3)).sum(-2)
    # Sums of 9 products, in another order.
    torch.testing.assert_close(sh.evaluate(light, directions), expected, atol=1e-14, rtol=0)


@pytest.mark.parametrize("order", [1, 2, 5])
def test_bands_name_the_band_of_every_index(order):
    index = torch.arange(order * order)
    assert torch.equal(sh.bands(order), index.sqrt().floor().long())
