"""Do height fields and their tiling make patches without seams?"""

import numpy as np
import pytest
import torch
from PIL import Image

from torchprt.errors import InputError
from torchprt.scene import height_field, make_mesh, read_heights, tiled
from torchprt.scene.samples import bumps, waffle, wrinkles

PATCHES = [bumps, waffle, wrinkles]


def test_refuses_heights_that_make_no_patch():
    with pytest.raises(InputError, match="at least 2 x 2"):
        height_field(torch.zeros(1, 8))
    with pytest.raises(InputError, match="not finite"):
        height_field(torch.tensor([[0.0, 1.0], [torch.nan, 0.0]]))


@pytest.mark.parametrize("patch", PATCHES)
def test_refuses_too_little_detail(patch):
    with pytest.raises(InputError, match="give at least 8"):
        patch(7)


def test_refuses_to_tile_what_does_not_fill_the_square():
    half = make_mesh(torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [0.5, 1, 0]]), torch.tensor([[0, 1, 2]]), name="half")
    with pytest.raises(InputError, match=r"half spans 0 to 0\.5 in x"):
        tiled(half)
    with pytest.raises(InputError, match="around is -1"):
        tiled(bumps(8), -1)
    assert len(tiled(half, 0).positions) == 3


def test_a_flat_field_is_the_unit_square_facing_the_eye():
    mesh = height_field(torch.zeros(3, 5))
    assert mesh.positions.amin(0).tolist() == [0, 0, 0]
    assert mesh.positions.amax(0).tolist() == [1, 1, 0]
    assert bool((mesh.normals == torch.tensor([0.0, 0.0, 1.0])).all())
    corners = mesh.positions[mesh.faces]
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert bool((area[:, 2] > 0).all())
    assert float(area.sum()) == pytest.approx(2)
    assert torch.equal(mesh.uv, corners[..., :2])
    assert bool((mesh.tangents == torch.tensor([1.0, 0.0, 0.0])).all())


def test_heights_stand_where_they_were_given():
    heights = torch.arange(12.0).view(3, 4)
    mesh = height_field(heights, 0.5)
    z = mesh.positions[:, 2].view(4, 5)
    assert torch.equal(z[:3, :4], 0.5 * heights.double())
    assert torch.equal(z[3], z[0])
    assert torch.equal(z[:, 4], z[:, 0])


def test_normals_are_those_of_the_surface_it_samples():
    n = 64
    ticks = torch.arange(n, dtype=torch.float64) / n
    wave = 0.05 * torch.sin(2 * torch.pi * ticks)[None, :] + 0.03 * torch.cos(2 * torch.pi * ticks)[:, None]
    mesh = height_field(wave)
    slope_x = 0.1 * torch.pi * torch.cos(2 * torch.pi * mesh.positions[:, 0])
    slope_y = -0.06 * torch.pi * torch.sin(2 * torch.pi * mesh.positions[:, 1])
    exact = torch.nn.functional.normalize(torch.stack([-slope_x, -slope_y, torch.ones_like(slope_x)], -1), dim=-1)
    # Central differences are short by (2 pi / n)^2 / 6 of the slope, which is at most .31.
    assert (mesh.normals - exact).abs().max() < 0.31 * (2 * np.pi / n) ** 2 / 6 * 1.1


@pytest.mark.parametrize("patch", PATCHES)
def test_copies_of_a_patch_join_without_a_seam(patch):
    mesh = patch(16)
    copies = tiled(mesh, 1)
    count = len(mesh.positions)
    assert len(copies.positions) == 9 * count
    assert torch.equal(copies.positions[:count], mesh.positions)
    rounded = (copies.positions * 1e6).round()
    _, place = torch.unique(rounded[:, :2], dim=0, return_inverse=True)
    for values in (copies.positions[:, 2:], copies.normals):
        low = torch.full((int(place.max()) + 1, values.shape[1]), torch.inf, dtype=torch.float64)
        high = -low
        index = place[:, None].expand_as(values)
        low = low.scatter_reduce(0, index, values, "amin")
        high = high.scatter_reduce(0, index, values, "amax")
        assert float((high - low).max()) == 0


@pytest.mark.parametrize("patch", PATCHES)
def test_patches_are_reliefs_of_the_depth_they_promise(patch):
    flat, deep = patch(24, depth=0.0), patch(24, depth=0.2)
    assert float(flat.positions[:, 2].abs().max()) == 0
    height = float(deep.positions[:, 2].max() - deep.positions[:, 2].min())
    assert 0.15 < height <= 0.2


def test_heights_of_a_picture_are_its_numbers_with_the_top_row_last(tmp_path):
    values = np.array([[0, 51], [102, 255]], dtype=np.uint8)
    Image.fromarray(values).save(tmp_path / "relief.png")
    heights = read_heights(tmp_path / "relief.png")
    assert (heights - torch.tensor([[0.4, 1.0], [0.0, 0.2]])).abs().max() < 1e-6


def test_names_the_picture_that_is_missing(tmp_path):
    with pytest.raises(InputError, match=r"none\.png"):
        read_heights(tmp_path / "none.png")
