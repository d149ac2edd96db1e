"""The fast way to turn lights, against the quadrature that `Rotation` always uses."""

import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError
from torchprt.sh.euler import turn_by_euler

EPS = {torch.float32: 2**-23, torch.float64: 2**-52}


def lights(*shape, dtype=torch.float64):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(3)).to(dtype)


def about_each_axis(angle):
    axes = torch.linalg.cross(torch.eye(3).double().expand(3, 3, 3), torch.eye(3).double().unsqueeze(1))
    return torch.linalg.matrix_exp(angle * axes)


def tolerance(order, dtype):
    """Entries of the matrix rounded to eps move band l by l eps; the recurrences of both ways lose order^2 eps."""
    return (16 * order + order**2) * EPS[dtype]


def both_ways(rotation, order):
    light = lights(len(rotation), order**2, 2, dtype=rotation.dtype)
    return turn_by_euler(light, rotation), sh.Rotation(order, rotation.dtype)(light, rotation)


def test_refuses_a_light_that_is_not_square():
    with pytest.raises(InputError, match="square"):
        turn_by_euler(lights(8, 3), torch.eye(3).double())


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("angle", [0.0, 1e-30, 1e-16, 1e-8, 1e-7, 1e-5, 1e-3, 1.0, torch.pi / 2, 3.0])
@pytest.mark.parametrize("order", [1, 2, 5, 6, 20])
def test_agrees_with_quadrature_at_and_near_the_poles(order, angle, dtype):
    small = about_each_axis(angle)
    halves = torch.diag_embed(2 * torch.eye(3).double() - 1)
    turned = (halves.unsqueeze(1) @ small).flatten(0, 1)
    fast, exact = both_ways(torch.cat([small, turned, turned @ small[0], turned @ small[1]]).to(dtype), order)
    torch.testing.assert_close(fast, exact, atol=tolerance(order, dtype), rtol=0)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("order", [*range(1, 10), 16, 32])
def test_agrees_with_quadrature_at_random_turns(order, dtype):
    angles = 360 * torch.rand(20, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(4))
    fast, exact = both_ways(sh.yaw_pitch_roll(angles).to(dtype), order)
    torch.testing.assert_close(fast, exact, atol=tolerance(order, dtype), rtol=0)


def test_float32_keeps_to_the_accuracy_of_its_input():
    light, rotation = lights(50, 36, 3), sh.yaw_pitch_roll(360 * torch.rand(50, 3)).double()
    single, double = turn_by_euler(light.float(), rotation.float()), turn_by_euler(light, rotation.float().double())
    # Two products of up to eleven terms, and m = 5 times the rounding of an angle.
    assert (single - double).abs().max() < 4 * 6 * EPS[torch.float32]


@pytest.mark.parametrize("shape", [(), (1,), (2,)])
def test_leaves_its_arguments_as_they_were(shape):
    light, rotation = lights(*shape, 9, 3), about_each_axis(1.0)[0]
    before, turn = light.clone(), rotation.clone()
    result = turn_by_euler(light, rotation)
    assert result.is_contiguous()
    assert result.data_ptr() != light.data_ptr()
    assert torch.equal(light, before)
    assert torch.equal(rotation, turn)


def test_takes_lights_and_rotations_that_are_strided_views():
    light, rotation = lights(4, 3, 16), about_each_axis(0.3)
    expected = turn_by_euler(light[1:].mT.contiguous(), rotation.mT.contiguous())
    assert torch.equal(turn_by_euler(light[1:].mT, rotation.mT), expected)
