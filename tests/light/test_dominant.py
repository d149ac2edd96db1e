"""Is the one lamp that stands for a light the best of its direction?"""

import math

import pytest
import torch

from torchprt.errors import InputError
from torchprt.light import constant, directional, dominant
from torchprt.sh import rotate, yaw_pitch_roll


def test_refuses_what_is_no_light():
    with pytest.raises(InputError):
        dominant(torch.zeros(5, 3))


@pytest.mark.parametrize("order", [2, 3, 5, 8])
def test_a_lamp_is_found_again(order):
    direction = torch.nn.functional.normalize(torch.tensor([0.3, -0.7, 0.2], dtype=torch.float64), dim=0)
    colour = torch.tensor([3.0, 2.0, 0.5], dtype=torch.float64)
    found, radiance = dominant(directional(direction, colour, order=order))
    # Sums of n^2 products in float64.
    assert torch.allclose(found, direction, atol=order**2 * 1e-15)
    assert torch.allclose(radiance, colour, rtol=order**2 * 1e-15)


def test_it_turns_with_the_light_and_scales_with_it():
    light = torch.randn(7, 25, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    turn = yaw_pitch_roll(torch.tensor([40.0, -20.0, 70.0], dtype=torch.float64))
    (direction, radiance), (turned, same) = dominant(light), dominant(rotate(light, turn))
    assert torch.allclose(turned, direction @ turn.T, atol=1e-13)
    assert torch.allclose(same, radiance, atol=1e-13)
    scaled, larger = dominant(1e30 * light)
    assert torch.allclose(scaled, direction, atol=1e-13)
    assert torch.allclose(larger, 1e30 * radiance, rtol=1e-12)


def test_no_other_radiance_of_that_direction_is_nearer():
    light = torch.randn(16, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64) + constant(1.0, 4)
    direction, radiance = dominant(light)
    best = (light - directional(direction, radiance, order=4)).square().sum(0)
    for factor in (0.99, 1.01):
        other = (light - directional(direction, factor * radiance, order=4)).square().sum(0)
        assert bool((other >= best).all())


def test_light_from_everywhere_or_nowhere_comes_from_above():
    for light in (constant(2.0, 1), constant(2.0, 3), torch.zeros(9, 3)):
        direction, radiance = dominant(light.double())
        assert direction.tolist() == [0, 1, 0]
        assert bool(radiance.ge(0).all())
    assert dominant(torch.zeros(9, 3))[1].tolist() == [0, 0, 0]


def test_a_channel_that_is_brighter_elsewhere_is_not_negative():
    red = directional((0.0, 1.0, 0.0), (5.0, 0.0, 0.0), order=3)
    blue = directional((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), order=3)
    direction, radiance = dominant(red + blue)
    assert direction[1] > 0.9
    assert radiance[0] == pytest.approx(5.0, rel=1e-6)
    assert radiance[2] >= 0


def test_gradients_flow():
    light = torch.randn(2, 9, 3, generator=torch.Generator().manual_seed(3), dtype=torch.float64, requires_grad=True)
    direction, radiance = dominant(light)
    (direction[..., 0].sum() + radiance.sum()).backward()
    assert light.grad is not None
    assert bool(light.grad.isfinite().all())
    assert math.isfinite(float(light.grad.norm()))
    assert float(light.grad.norm()) > 0
