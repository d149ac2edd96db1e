"""Does a lit model come back from its file as it was?"""

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.preview import colours, save_ply
from torchprt.preview.model import tone_map
from torchprt.scene import read_mesh
from torchprt.shade import display

POSITIONS = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [9.0, 9.0, 9.0]])
FACES = torch.tensor([[0, 1, 2], [2, 3, 0]], dtype=torch.int32)
COLOURS = torch.tensor([[0, 10, 255], [1, 2, 3], [128, 128, 128], [4, 5, 6], [7, 8, 9]], dtype=torch.uint8)


@pytest.mark.parametrize("name", ["", "Filmic", "aces"])
def test_refuses_a_tone_map_that_is_not_there(name):
    with pytest.raises(InputError, match=f"tone map '{name}'"):
        tone_map(name)
    with pytest.raises(InputError, match="tone map"):
        colours(torch.zeros(1, 3), tone=name)


def test_colours_are_what_a_screen_shows_to_the_nearest_of_256():
    radiance = torch.tensor([[0.0, 0.18, 1.0], [-1.0, 1e-30, 1e30], [0.5, 2.0, 4.0]])
    for tone in ("none", "filmic"):
        shown = display(radiance, exposure=-1.0, tone=tone)
        found = colours(radiance, -1.0, tone)
        assert found.dtype == torch.uint8
        assert ((found / 255 - shown).abs() <= 0.5 / 255 + 1e-6).all()
    assert colours(torch.zeros(0, 3)).shape == (0, 3)


def test_a_ply_keeps_vertices_faces_and_colours_in_order(tmp_path):
    save_ply(POSITIONS, FACES, COLOURS, tmp_path / "a.ply")
    there = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_array_equal(there.vertices, POSITIONS.numpy())
    np.testing.assert_array_equal(there.faces, FACES.numpy())
    np.testing.assert_array_equal(there.visual.vertex_colors[:, :3], COLOURS.numpy())
    again = read_mesh(tmp_path / "a.ply")
    assert torch.equal(again.faces, FACES.long())
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ply"]


@pytest.mark.parametrize("faces", [FACES, FACES[:0]])
def test_the_bytes_of_a_ply_are_those_of_trimesh(faces, tmp_path):
    save_ply(POSITIONS.double() / 3, faces.long(), COLOURS, tmp_path / "a.ply")
    points, colour = POSITIONS.double().numpy() / 3, COLOURS.numpy()
    if len(faces):
        model = trimesh.Trimesh(points, faces.numpy(), vertex_colors=colour, process=False)
    else:
        model = trimesh.PointCloud(points, colors=colour)
    wanted = model.export(file_type="ply").replace(b"comment https://github.com/mikedh/trimesh\n", b"")
    assert (tmp_path / "a.ply").read_bytes() == wanted


def test_loose_points_become_a_point_cloud(tmp_path):
    save_ply(POSITIONS, torch.zeros(0, 3, dtype=torch.int32), COLOURS, tmp_path / "a.ply")
    there = trimesh.load(tmp_path / "a.ply", process=False)
    assert isinstance(there, trimesh.PointCloud)
    np.testing.assert_array_equal(there.vertices, POSITIONS.numpy())
    np.testing.assert_array_equal(there.colors[:, :3], COLOURS.numpy())


def test_a_ply_that_cannot_be_written_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        save_ply(POSITIONS, FACES, COLOURS, tmp_path / "none" / "a.ply")
    assert not list(tmp_path.iterdir())
