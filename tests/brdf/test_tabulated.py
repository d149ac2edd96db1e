"""Is a table read where its entries stand, and is a function of the user's checked?"""

import math

import pytest
import torch

from torchprt.brdf import GGX, Measured, Tabulated, Ward, reciprocity_error
from torchprt.errors import InputError


def directions(theta, phi):
    theta, phi = torch.broadcast_tensors(theta, phi)
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)


def tilts(count):
    return torch.linspace(0, math.pi / 2, count, dtype=torch.float64)


def isotropic_table(brdf, count, turns):
    # The last angle is just above the horizon, where models stop.
    theta = tilts(count).clamp(max=math.pi / 2 - 1e-9)
    turn = torch.linspace(0, math.pi, turns, dtype=torch.float64)
    view = directions(theta, torch.zeros(1, dtype=torch.float64))
    return brdf(view[:, None, None], directions(theta[:, None], turn))


def anisotropic_table(brdf, count, turns):
    theta = tilts(count).clamp(max=math.pi / 2 - 1e-9)
    turn = torch.arange(turns, dtype=torch.float64) * (2 * math.pi / turns)
    grid = directions(theta[:, None], turn)
    return brdf(grid[:, :, None, None], grid)


@pytest.mark.parametrize(
    ("values", "match"),
    [
        (torch.ones(3, 3), "shape"),
        (torch.ones(3, 3, 3, 3, 3), "shape"),
        (torch.ones(0, 3, 3), "shape"),
        (torch.ones(3, 1, 3), "at least 2"),
        (torch.ones(3, 3, 3, dtype=torch.int64), "int64"),
        (-torch.ones(3, 3, 3), "negative"),
        (torch.full((3, 3, 3), math.nan), "NaN"),
        (torch.full((3, 3, 3), math.inf), "infinities"),
    ],
)
def test_refuses_tables_that_are_none(values, match):
    with pytest.raises(InputError, match=match):
        Tabulated(values)


def test_the_table_is_a_copy():
    values = torch.ones(2, 2, 2)
    brdf = Tabulated(values)
    values.zero_()
    pole = torch.tensor([0.0, 0.0, 1.0])
    assert float(brdf(pole, pole)) == 1


def test_an_isotropic_table_is_exact_at_its_entries():
    values = torch.rand(5, 6, 7, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    brdf = Tabulated(values)
    theta_v, theta_s = tilts(5)[1:-1], tilts(6)[1:-1]
    turn = torch.linspace(0, math.pi, 7, dtype=torch.float64)
    view = directions(theta_v, torch.tensor(2.1, dtype=torch.float64))
    # The turn counts both ways.
    for sign in (1, -1):
        light = directions(theta_s[:, None], 2.1 + sign * turn)
        found = brdf(view[:, None, None], light)
        torch.testing.assert_close(found, values[1:-1, 1:-1], rtol=0, atol=1e-13)


def test_an_anisotropic_table_is_exact_at_its_entries_and_goes_around():
    values = torch.rand(4, 5, 6, 7, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    brdf = Tabulated(values)
    view = directions(tilts(4)[1:-1, None], torch.arange(5, dtype=torch.float64) * (2 * math.pi / 5))
    light = directions(tilts(6)[1:-1, None], torch.arange(7, dtype=torch.float64) * (2 * math.pi / 7))
    torch.testing.assert_close(brdf(view[:, :, None, None], light), values[1:-1, :, 1:-1], rtol=0, atol=1e-13)
    # Between the last azimuth and the first.
    between = directions(tilts(6)[2], torch.tensor(6.5 * 2 * math.pi / 7, dtype=torch.float64))
    expected = (values[1, 2, 2, 6] + values[1, 2, 2, 0]) / 2
    torch.testing.assert_close(brdf(view[0, 2], between), expected, rtol=1e-12, atol=0)


def test_tables_of_models_agree_with_the_models():
    view = torch.nn.functional.normalize(torch.tensor([[0.3, 0.2, 0.9], [-0.6, 0.1, 0.7]], dtype=torch.float64), dim=-1)
    light = torch.nn.functional.normalize(
        torch.tensor([[-0.1, 0.3, 0.8], [0.5, 0.2, 0.6]], dtype=torch.float64), dim=-1
    )
    smooth, brushed = GGX(0.6), Ward(0.6, 0.9)
    # Linear interpolation: the square of the step, .035 and .1, times a curvature of a few.
    torch.testing.assert_close(
        Tabulated(isotropic_table(smooth, 46, 46))(view, light), smooth(view, light), rtol=0.01, atol=0
    )
    table = Tabulated(anisotropic_table(brushed, 16, 32))
    torch.testing.assert_close(table(view, light), brushed(view, light), rtol=0.05, atol=0)
    assert table.reciprocal
    assert not table.isotropic


def test_knows_whether_it_is_reciprocal():
    table = Tabulated(isotropic_table(GGX(0.5), 10, 10))
    assert table.reciprocal
    assert reciprocity_error(table) < 1e-12
    lopsided = Tabulated(torch.rand(4, 4, 4, generator=torch.Generator().manual_seed(0)))
    assert not lopsided.reciprocal
    assert reciprocity_error(lopsided) > 0.1


@pytest.mark.parametrize("shape", [(2, 2, 2), (2, 2, 2, 2), (3, 4, 5)])
def test_the_least_tables_hold_a_constant(shape):
    brdf = Tabulated(torch.full(shape, 0.25, dtype=torch.float64))
    view = directions(tilts(40)[:-1], torch.linspace(-4, 4, 39, dtype=torch.float64))
    torch.testing.assert_close(brdf(view[:, None], view), torch.full((39, 39), 0.25).double(), rtol=1e-14, atol=0)


def test_gradients_of_a_table_are_right():
    brdf = Tabulated(torch.rand(5, 5, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64))
    view = torch.tensor([[0.3, 0.2, 0.9]], dtype=torch.float64, requires_grad=True)
    light = torch.tensor([[-0.1, 0.3, 0.8]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(brdf, (view, light))


@pytest.mark.parametrize(
    ("function", "match"),
    [
        (lambda view, light: -(view * light).sum(-1), "negative"),
        (lambda view, light: (view * light).sum(-1) / 0, "infinities"),
        (lambda view, light: view * light, "shape"),
        (lambda view, light: 1.0, "float"),
    ],
)
def test_refuses_what_a_function_should_not_return(function, match):
    normal = torch.tensor([[0.0, 0.0, 1.0]])
    with pytest.raises(InputError, match=match):
        Measured(function, "paint")(normal, normal)


def test_refuses_a_lobe_without_width():
    with pytest.raises(InputError, match="width"):
        Measured(lambda view, light: (view * light).sum(-1), width=0.0)


def test_a_function_is_called_above_the_horizon_only():
    seen = []

    def function(view, light):
        seen.append((view, light))
        return (view * light).sum(-1).square()

    grid = torch.tensor([[0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [1.0, 0.0, 0.0]], dtype=torch.float64)
    value = Measured(function)(grid[:, None], grid)
    assert all((part[..., 2] > 0).all() for pair in seen for part in pair)
    assert float(value[1, 1]) == pytest.approx(1)
    assert float(value.sum()) == float(value[1, 1])
