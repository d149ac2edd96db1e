"""Is what stands behind the model the environment that lights it?"""

import math

import pytest
import torch

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.preview import automatic_exposure, built_in_environment, photograph, seen_along
from torchprt.preview.environment import for_pixels
from torchprt.shade import display

EPS = torch.finfo(torch.float32).eps


def ramp(height=32):
    """A map that is linear in the direction, so that it has no features below a texel."""
    directions = sh.latlong_directions(height, 2 * height, dtype=torch.float32)
    return 2 + directions


def directions(count=500, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


@pytest.mark.parametrize("shape", [(4, 4, 3), (8, 4, 3), (0, 0, 3)])
def test_refuses_what_is_no_latitude_longitude_map(shape):
    with pytest.raises(InputError, match="no latitude-longitude map"):
        seen_along(torch.zeros(shape), torch.ones(1, 3))


def test_the_middle_of_a_texel_reads_that_texel():
    image = torch.rand(9, 18, 3, generator=torch.Generator().manual_seed(1))
    along = sh.latlong_directions(9, 18, dtype=torch.float64)
    # The map is read where an angle in float32 says: some roundings of a place up to 18 texels.
    torch.testing.assert_close(seen_along(image, along), image, rtol=0, atol=100 * EPS)


@pytest.mark.parametrize("axis", [(0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0)])
@pytest.mark.parametrize("length", [1e-15, 1.0, 1e15])
def test_poles_and_the_seam_read_what_is_there(axis, length):
    along = length * torch.tensor([axis], dtype=torch.float32)
    found = seen_along(ramp(64), along)
    # Poles and texels lie half a texel apart at most, 1.4 degrees.
    torch.testing.assert_close(found, 2 + along / length, rtol=0, atol=math.pi / 64)


def test_the_turned_map_shows_the_turned_light():
    turn = sh.yaw_pitch_roll(torch.tensor([70.0, 20.0, -40.0]))
    along = directions()
    # f(R^T s), by one direction after the other.
    wanted = torch.stack([2 + turn.T @ each for each in along])
    torch.testing.assert_close(seen_along(ramp(128), along, turn), wanted, rtol=0, atol=2e-3)


def test_a_photograph_of_a_light_projects_back_to_it():
    lamp = light.constant((1.0, 2.0, 3.0), 4).float()
    lamp[2] = torch.tensor([0.3, -0.2, 0.1])
    picture = photograph(lamp, 64)
    assert picture.shape == (64, 128, 3)
    # The midpoint rule on 64 rows errs by a few of their squared height, 2.4e-3.
    torch.testing.assert_close(light.project(picture, 4), lamp, rtol=0, atol=5e-3)


def test_a_photograph_is_black_where_the_light_rings():
    lamp = light.disc((0.0, 1.0, 0.0), 0.1, 1.0, 5).float()
    picture = photograph(lamp)
    assert float(picture.min()) == 0
    assert float(picture.max()) > 0


@pytest.mark.parametrize("radiance", [1e-20, 0.3, 1.0, 1e20])
def test_automatic_exposure_shows_lights_of_any_strength_alike(radiance):
    lamp = light.constant(radiance, 3).float()
    shown = display(torch.full((1, 3), radiance), exposure=automatic_exposure(lamp), tone="none")
    one = display(torch.ones(1, 3), exposure=automatic_exposure(light.constant(1.0, 3).float()), tone="none")
    # Stops of some 66 round to 1e-5 of the value.
    torch.testing.assert_close(shown, one, rtol=0, atol=1e-5)
    # A white surface is white.
    assert float(shown.mean()) == pytest.approx(1, abs=1e-3)


def test_a_black_light_is_not_exposed():
    assert automatic_exposure(torch.zeros(4, 3)) == 0.0


# Exposure and lights that are always there


@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (0.3, -0.4, 0.8), (-1.0, 0.2, 0.1)])
@pytest.mark.parametrize("order", [2, 5, 8])
def test_a_white_surface_that_faces_the_only_lamp_is_white(direction, order):
    """`directional` reads its radiance on a surface that faces it; above order 5 the exposure looks at 5 bands."""
    lamp = light.directional(direction, 3.0, order=min(order, 5)).float()
    lamp = torch.cat([lamp, torch.zeros(order**2 - len(lamp), 3)])
    # Directions of the meter are 7.5 degrees apart: the nearest is within 5.3, whose cosine is .9957.
    assert automatic_exposure(lamp) == pytest.approx(-math.log2(3.0), abs=0.015)


def test_exposure_does_not_follow_a_light_that_turns():
    lamp = light.project(light.studio(64), 5)
    stops = [
        automatic_exposure(sh.rotate(lamp, sh.yaw_pitch_roll(torch.tensor([yaw, 17.0, 5.0]))))
        for yaw in (0.0, 33.0, 120.0, 250.0)
    ]
    assert max(stops) - min(stops) < 0.02


@pytest.mark.parametrize("name", light.BUILT_IN)
def test_a_light_that_is_always_there_does_not_ring_unless_asked_to(name):
    directions, _ = sh.fibonacci(1000)
    found, bare = built_in_environment(name, 5), built_in_environment(name, 5, "none")
    assert found.image.shape == (256, 512, 3)
    assert float(sh.evaluate(found.light.double(), directions).min()) > -1e-4 * float(found.light.abs().max())
    torch.testing.assert_close(bare.light, light.project(bare.image, 5))


# What pixels show of a map


@pytest.mark.parametrize("factor", [0.3, 1.0, 5.0])
def test_a_map_for_pixels_keeps_its_light(factor):
    image = torch.rand(32, 64, 3, generator=torch.Generator().manual_seed(0))
    made = for_pixels(image, math.pi / 32 / factor)
    assert made.shape[1] == 2 * made.shape[0]
    assert made.shape[0] == (10 if factor == 0.3 else 32)
    # Averages of averages; the poles are repeated where it is smoothed.
    torch.testing.assert_close(made.mean((0, 1)), image.mean((0, 1)), rtol=0, atol=0.03)
    assert torch.equal(made, image) == (factor == 1.0)


def test_a_map_that_is_smoothed_closes_across_the_seam():
    image = torch.zeros(16, 32, 3)
    image[8, 0] = 1.0
    made = for_pixels(image, math.pi / 1000)
    torch.testing.assert_close(made[8, 1], made[8, -1])
    assert float(made[8, -1].min()) > 0.05
