"""Are the lights that are always there what their names say, at any size?"""

import math

import pytest
import torch

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.light import BUILT_IN, built_in, project


def irradiance(image, normal):
    """Of a surface with this normal, `[3]`."""
    height = image.shape[0]
    directions = sh.latlong_directions(height, 2 * height)
    cosine = (directions @ torch.tensor(normal).double()).clamp(min=0)
    return (image.double() * (sh.latlong_weights(height, 2 * height) * cosine)[..., None]).sum((0, 1))


@pytest.mark.parametrize("name", ["", "Studio", "moon"])
def test_refuses_a_light_that_is_not_there_and_names_those_that_are(name):
    with pytest.raises(InputError, match=r"studio, .* or white"):
        built_in(name)


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("height", [-1, 0, 1])
def test_refuses_a_map_without_rows(name, height):
    with pytest.raises(InputError, match=f"height is {height}"):
        built_in(name, height)


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("height", [2, 7, 64])
def test_each_is_an_environment_that_can_be_projected(name, height):
    image = built_in(name, height)
    assert image.shape == (height, 2 * height, 3)
    assert image.dtype == torch.float32
    assert bool(image.isfinite().all())
    assert float(image.min()) >= 0
    assert project(image, 3).shape == (9, 3)


@pytest.mark.parametrize("name", BUILT_IN)
def test_each_is_the_same_at_any_size(name):
    coarse, fine = (project(built_in(name, height), 4) for height in (128, 512))
    # Rims of lamps fall on whole texels: a few hundredths of the light.
    assert float((coarse - fine).norm() / fine.norm()) < 0.03


def test_all_differ():
    lights = [project(built_in(name, 64), 3) for name in BUILT_IN]
    for one in range(len(lights)):
        for other in range(one):
            a, b = (each / each.norm() for each in (lights[one], lights[other]))
            assert float((a - b).norm()) > 0.1


def test_three_point_is_without_colour_and_its_key_stands_to_the_right_of_the_camera():
    image = built_in("three-point", 128)
    assert float((image.amax(-1) - image.amin(-1)).max()) == 0
    right, left, back = (
        irradiance(image, normal)[0] for normal in ((0.6, 0.0, 0.8), (-0.6, 0.0, 0.8), (0.0, 0.0, -1.0))
    )
    assert right > 2 * left
    assert left > 0.3 * back > 0


def test_noon_lights_level_ground_in_white_and_sunset_shines_warm_from_low():
    noon, evening = built_in("sky", 256), built_in("sunset", 256)
    level = irradiance(noon, (0.0, 1.0, 0.0))
    # Its balance is written to three digits.
    torch.testing.assert_close(level / level.mean(), torch.ones(3).double(), rtol=0, atol=2e-3)
    # The middle of the sun, 9 degrees high, in rows of .7 degrees.
    sun = evening.sum(-1) > 0.9 * float(evening.sum(-1).max())
    rows = sun.any(1).nonzero()[:, 0].double()
    assert 90 - float(rows.amin() + 0.5) / 256 * 180 == pytest.approx(9 + 12, abs=0.8)
    facing = irradiance(evening, (0.7, 0.0, 0.714))
    assert float(facing[0]) > 1.3 * float(facing[2])
    # Light of noon is many times that of evening.
    assert float(level.mean()) > 3 * float(irradiance(evening, (0.0, 1.0, 0.0)).mean())


def test_overcast_is_the_cie_sky_in_closed_form():
    found = project(built_in("overcast", 256), 3)
    wanted = light.overcast_sky(1.0, (0.0, 1.0, 0.0), 3).float()
    # The ground of the closed form is 7/9 of the albedo too; its horizon is no whole texel.
    torch.testing.assert_close(found, wanted.expand(9, 3), rtol=0, atol=0.01)


def test_white_is_one_everywhere():
    assert torch.equal(built_in("white", 8), torch.ones(8, 16, 3))
    constant = project(built_in("white", 64), 2)
    torch.testing.assert_close(constant[0], torch.full((3,), math.sqrt(4 * math.pi)), rtol=1e-3, atol=0)
