"""Is the room as it is described: lamps where they are said to be, usable radiance everywhere?"""

import math

import pytest
import torch

from torchprt import sh
from torchprt.errors import InputError
from torchprt.light import project, studio
from torchprt.light.studio import LAMPS


@pytest.mark.parametrize("height", [-1, 0, 1])
def test_refuses_a_map_without_rows(height):
    with pytest.raises(InputError, match=f"height is {height}"):
        studio(height)


@pytest.mark.parametrize("height", [2, 3, 128])
def test_is_an_environment(height):
    room = studio(height)
    assert room.shape == (height, 2 * height, 3)
    assert room.dtype == torch.float32
    assert (room > 0).all()
    assert room.isfinite().all()
    assert project(room, 3).shape == (9, 3)


def texel(direction, height):
    """Row and column of a direction, by the formula of docs/conventions.md the other way round."""
    x, y, z = (value / math.dist(direction, (0, 0, 0)) for value in direction)
    theta, phi = math.acos(y), math.atan2(x, -z)
    return int(theta / math.pi * height), int((phi + math.pi) / (2 * math.pi) * 2 * height)


@pytest.mark.parametrize("number", range(len(LAMPS)))
def test_each_lamp_shines_from_its_direction_and_not_from_the_opposite(number):
    middle, _, radiance = LAMPS[number]
    room = studio(128)
    assert torch.equal(room[texel(middle, 128)], torch.tensor(radiance))
    assert float(room[texel([-value for value in middle], 128)].max()) < 0.5


@pytest.mark.parametrize("number", range(len(LAMPS)))
def test_each_lamp_has_the_solid_angle_of_its_rectangle(number):
    _, (width, height), radiance = LAMPS[number]
    room = studio(512)
    theta = (torch.arange(512, dtype=torch.float64) + 0.5) * math.pi / 512
    lit = (room == torch.tensor(radiance)).all(-1)
    found = float((lit.sum(1) * theta.sin()).sum() * (math.pi / 512) ** 2)
    # A rectangle at distance 1 seen from above its middle.
    expected = 4 * math.asin(width * height / math.sqrt((1 + width**2) * (1 + height**2)))
    # The rim is known to half a texel: 1 % of the area at lamps 50 texels wide, twice that at the narrowest.
    assert found == pytest.approx(expected, rel=0.02)


def test_the_key_is_to_the_right_above_and_in_front_and_brightest():
    light = project(studio(128), 2).sum(-1)
    # Band 1 points to the mean of the light: y, z and x of the direction, with the Condon-Shortley sign.
    mean = torch.stack([-light[3], -light[1], light[2]])
    assert (mean > 0).all()
    key = torch.nn.functional.normalize(torch.tensor(LAMPS[0][0]), dim=0)
    assert float(torch.nn.functional.normalize(mean, dim=0) @ key) > 0.9


def test_a_finer_map_is_the_same_light():
    coarse, fine = (project(studio(height), 4) for height in (128, 512))
    # Lamps end at texels: half a texel of their rims.
    assert float((coarse - fine).norm() / fine.norm()) < 0.02


def test_walls_go_over_into_ceiling_and_floor_by_height_alone():
    room = studio(64)
    directions = sh.latlong_directions(64, 128, dtype=torch.float32)
    dim = room.amax(-1) < 0.5
    for row in range(64):
        values = room[row][dim[row]]
        # Rounding of the height, which differs a little from column to column.
        assert float((values - values[0]).abs().max()) < 1e-6
    assert float(directions[0, 0, 1]) > 0.99
    assert float(room[0].mean()) > float(room[-1].mean())
