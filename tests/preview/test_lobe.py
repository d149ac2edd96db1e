"""Is a lobe the function that it shows?"""

import math

import pytest
import torch

from torchprt import sh
from torchprt.preview import lobe
from torchprt.preview.lobe import sphere

PLACE = torch.tensor([3.0, -2.0, 5.0], dtype=torch.float64)


def coefficients(order, seed=0):
    return torch.randn(order * order, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("order", [1, 4])
def test_nothing_has_no_lobe(order):
    assert lobe(torch.zeros(order * order), PLACE, 1.0) is None


@pytest.mark.parametrize("order", [1, 2, 5, 12])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_distance_is_magnitude_and_colour_is_sign(order, scale):
    function = scale * coefficients(order)
    found = lobe(function, PLACE, 2.0)
    offset = found.positions - PLACE
    distance = offset.norm(dim=-1)
    along = offset[distance > 1e-3] / distance[distance > 1e-3, None]
    value = sh.basis(along, order) @ function
    largest = float((sh.basis(sphere(48)[0], order) @ function).abs().max())
    # A direction off by one rounding of the place, 8, over the shortest distance.
    torch.testing.assert_close(distance[distance > 1e-3], 2 * value.abs() / largest, rtol=1e-9, atol=1e-10)
    red = found.colours[:, 0] > found.colours[:, 2]
    assert torch.equal(red[distance > 1e-3], value > 0)


def test_the_largest_reaches_the_size_that_was_asked_for():
    for order in (1, 3, 6):
        found = lobe(coefficients(order), PLACE, 0.7)
        assert float((found.positions - PLACE).norm(dim=-1).max()) == pytest.approx(0.7, rel=1e-12)


def test_faces_are_seen_from_outside_and_close_the_sphere():
    directions, faces = sphere(12)
    a, b, c = directions[faces].unbind(1)
    volume = (a * torch.linalg.cross(b, c)).sum(-1)
    assert float(volume.min()) >= -1e-15
    # Of a sphere by flat faces, a little less than 4 pi / 3.
    assert 0.95 < float(volume.sum()) / 6 / (4 * math.pi / 3) < 1


def test_rows_and_columns_are_those_of_a_latitude_longitude_map():
    directions, _ = sphere(6)
    grid = directions.view(7, 13, 3)
    torch.testing.assert_close(grid[3, 6], torch.tensor([0.0, 0.0, -1.0]).double(), rtol=0, atol=1e-15)
    torch.testing.assert_close(grid[3, 9], torch.tensor([1.0, 0.0, 0.0]).double(), rtol=0, atol=1e-15)
    torch.testing.assert_close(grid[0, 5], torch.tensor([0.0, 1.0, 0.0]).double(), rtol=0, atol=1e-15)


def test_colours_can_be_shown():
    found = lobe(coefficients(4), PLACE, 1.0)
    assert float(found.colours.min()) >= 0
    assert float(found.colours.max()) <= 1
