"""Are materials checked, and is every vertex, side and object found again in the geometry?"""

import math

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene import Material, Object, Points, Scene, load, make_mesh

TRIANGLE = make_mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]), name="triangle")
CUBE = make_mesh(np.array(trimesh.creation.box().vertices) + 5, np.array(trimesh.creation.box().faces), name="cube")
PAINTED = make_mesh(TRIANGLE.positions, TRIANGLE.faces, colours=torch.eye(3), name="painted")


# Misuse


@pytest.mark.parametrize("albedo", [-0.1, 1.1, math.nan, math.inf, [0.2, 0.3, 2.0], torch.tensor([[0.5], [-1.0]])])
def test_refuses_an_albedo_outside_zero_to_one(albedo):
    with pytest.raises(InputError, match=r"give values in \[0, 1\]"):
        Material(albedo)


@pytest.mark.parametrize("albedo", [[0.1, 0.2], torch.rand(3, 2), torch.rand(2, 3, 1), torch.rand(0, 3)])
def test_refuses_an_albedo_of_another_shape(albedo):
    with pytest.raises(InputError, match="shape"):
        Material(albedo)


def test_refuses_an_albedo_that_is_not_known():
    with pytest.raises(InputError, match="'gold'"):
        Material("gold")


def test_refuses_vertex_colours_where_there_are_none():
    with pytest.raises(InputError, match="triangle has no vertex colours"):
        Object(TRIANGLE, Material("vertex"))


def test_refuses_vertex_colours_brighter_than_one():
    bright = make_mesh(TRIANGLE.positions, TRIANGLE.faces, colours=2 * torch.eye(3), name="bright")
    with pytest.raises(InputError, match="bright as albedo ranges from 0 to 2"):
        Object(bright, Material("vertex"))


def test_refuses_an_albedo_with_another_number_of_rows():
    with pytest.raises(InputError, match="4 rows for the 3 vertices of triangle"):
        Object(TRIANGLE, Material(torch.rand(4, 3)))


def test_refuses_an_unknown_role():
    with pytest.raises(InputError, match="'mirror'"):
        Object(TRIANGLE, role="mirror")


def test_refuses_a_scene_of_nothing_or_of_blockers():
    with pytest.raises(InputError, match="no objects"):
        Scene([])
    with pytest.raises(InputError, match="only blockers"):
        Scene([Object(TRIANGLE, role="blocker")])
    with pytest.raises(InputError, match="no objects"):
        load([])


@pytest.mark.parametrize("bounces", [-1, 0.5, math.nan, -math.inf])
def test_refuses_a_number_of_bounces_that_is_none(bounces):
    with pytest.raises(InputError, match="bounces"):
        Scene([Object(TRIANGLE)]).requires(bounces)


def test_refuses_faces_that_are_not_indices_and_normals_that_are_too_few():
    with pytest.raises(InputError, match="faces of float64"):
        make_mesh(TRIANGLE.positions, np.array([[0.0, 1, 2]]))
    with pytest.raises(InputError, match="2 normals for 3 vertices"):
        make_mesh(TRIANGLE.positions, TRIANGLE.faces, normals=np.ones((2, 3)))
    with pytest.raises(InputError, match="4 colours for 3 vertices"):
        make_mesh(TRIANGLE.positions, TRIANGLE.faces, colours=np.ones((4, 3)))


# Materials


@pytest.mark.parametrize(
    ("albedo", "coloured"),
    [
        (0.5, False),
        (1, False),
        ([0.3, 0.3, 0.3], False),
        ((0.3, 0.3, 0.4), True),
        (torch.rand(3, 1), False),
        (torch.eye(3), True),
        (torch.ones(3, 3), False),
    ],
)
def test_a_material_is_coloured_if_its_channels_differ(albedo, coloured):
    assert Material(albedo).coloured == coloured
    assert Object(TRIANGLE, Material(albedo)).coloured == coloured


def test_vertex_albedo_is_the_colours_of_the_mesh():
    painted = Object(PAINTED, Material("vertex"))
    assert torch.equal(painted.albedo, torch.eye(3))
    grey = make_mesh(TRIANGLE.positions, TRIANGLE.faces, colours=torch.full((3, 3), 0.25))
    assert not Object(grey, Material("vertex")).coloured


# Requirements


def test_three_channels_only_where_light_bounces_off_colour():
    red = Material((0.6, 0.1, 0.1))
    coloured, grey = Scene([Object(TRIANGLE, red)]), Scene([Object(TRIANGLE)])
    assert [coloured.requires(n).channels for n in (0, 1, 5, math.inf)] == [1, 3, 3, 3]
    assert [grey.requires(n).channels for n in (0, 1, 5, math.inf)] == [1, 1, 1, 1]
    assert [grey.requires(n).hits for n in (0, 1, math.inf)] == [False, True, True]
    assert Scene([Object(TRIANGLE), Object(CUBE, red, "blocker")]).requires(2).channels == 1


# Geometry


def scene() -> Scene:
    return Scene(
        [
            Object(TRIANGLE, Material(0.2, two_sided=True)),
            Object(CUBE, Material(0.0), "blocker"),
            Object(CUBE, Material((0.1, 0.2, 0.3))),
            Object(PAINTED, Material("vertex", two_sided=True)),
        ]
    )


def test_all_objects_are_traced_once_in_order():
    geometry = scene().geometry()
    assert torch.equal(
        geometry.positions, torch.cat([TRIANGLE.positions, CUBE.positions, CUBE.positions, PAINTED.positions])
    )
    assert geometry.face_object.tolist() == [0] + [1] * 12 + [2] * 12 + [3]
    assert geometry.two_sided.tolist() == [True] + [False] * 24 + [True]
    for number, each in enumerate(scene().objects):
        corners = geometry.positions[geometry.faces[geometry.face_object == number]]
        assert torch.equal(corners, each.mesh.positions[each.mesh.faces])


def test_receivers_are_fronts_in_order_and_then_the_reverse_sides():
    geometry = scene().geometry()
    assert geometry.receivers == 3 + 8 + 3 + 3 + 3
    assert geometry.slices == (slice(0, 3), slice(3, 3), slice(3, 11), slice(11, 14))
    assert geometry.back_slices == (slice(14, 17), slice(17, 17), slice(17, 17), slice(17, 20))
    for number, each in enumerate(scene().objects):
        if each.receives:
            rows = geometry.slices[number]
            assert torch.equal(geometry.receiver_positions[rows], each.mesh.positions)
            assert torch.equal(geometry.receiver_normals[rows], each.mesh.normals)
        if each.receives and each.material.two_sided:
            rows = geometry.back_slices[number]
            assert torch.equal(geometry.receiver_positions[rows], each.mesh.positions)
            assert torch.equal(geometry.receiver_normals[rows], -each.mesh.normals)
            assert torch.equal(geometry.albedo[rows], geometry.albedo[geometry.slices[number]])


def test_every_vertex_knows_its_receivers():
    geometry = scene().geometry()
    front, back = geometry.receiver_of_vertex, geometry.back_receiver_of_vertex
    assert front.tolist() == [0, 1, 2] + [-1] * 8 + list(range(3, 11)) + [11, 12, 13]
    assert back.tolist() == [14, 15, 16] + [-1] * 16 + [17, 18, 19]
    for each, sign in ((front, 1), (back, -1)):
        known = each >= 0
        assert torch.equal(geometry.receiver_positions[each[known]], geometry.positions[known])
        assert torch.equal(geometry.receiver_normals[each[known]], sign * geometry.receiver_normals[front[known]])
    # Together they name every receiver once.
    assert torch.cat([front[front >= 0], back[back >= 0]]).sort().values.tolist() == list(range(20))


def test_display_faces_show_every_side_that_records_facing_its_normals():
    geometry = scene().geometry()
    assert len(geometry.display_faces) == 1 + 12 + 1 + 1 + 1
    corners = geometry.receiver_positions[geometry.display_faces]
    facing = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((facing[:, None] * geometry.receiver_normals[geometry.display_faces]).sum(dim=-1) > 0).all()


def test_albedo_has_three_channels_only_if_a_receiver_is_coloured():
    geometry = scene().geometry()
    assert geometry.albedo.shape == (20, 3)
    assert torch.equal(geometry.albedo[:3], torch.full((3, 3), 0.2))
    assert torch.equal(geometry.albedo[11:14], torch.eye(3))
    grey = Scene([Object(TRIANGLE, Material([0.3, 0.3, 0.3])), Object(CUBE, Material(0.1))]).geometry()
    assert torch.equal(grey.albedo, torch.tensor([0.3] * 3 + [0.1] * 8)[:, None])


# Loading


def test_load_takes_one_file_or_several_and_blockers(data, tmp_path):
    teapot = data / "mesh" / "teapot.ply"
    trimesh.creation.box().export(tmp_path / "box.ply")
    assert [each.role for each in load(teapot).objects] == ["receiver"]
    several = load([str(teapot), CUBE], albedo=(0.1, 0.2, 0.3), two_sided=True, blockers=tmp_path / "box.ply")
    assert [each.role for each in several.objects] == ["receiver", "receiver", "blocker"]
    assert several.objects[0].material.two_sided
    assert several.objects[1].mesh is CUBE
    assert "teapot.ply (receiver)" in str(several)
    assert "box.ply (blocker)" in str(several)


def test_load_names_the_file_without_colours(data):
    with pytest.raises(InputError, match=r"bunny\.ply has no vertex colours"):
        load(data / "mesh" / "bunny.ply", albedo="vertex")


# Points


def test_points_are_kept_in_float64_with_unit_normals():
    points = Points(torch.zeros(2, 3), torch.tensor([[0.0, 3, 4], [0, 0, 0]]), albedo=(0.1, 0.2, 0.3))
    assert points.positions.dtype == points.normals.dtype == torch.float64
    assert torch.equal(points.normals, torch.tensor([[0, 0.6, 0.8], [0, 0, 0]], dtype=torch.float64))
    assert torch.equal(points.albedo, torch.tensor([[0.1, 0.2, 0.3]]).expand(2, 3))


def test_refuses_points_that_cannot_record():
    one = torch.ones(1, 3)
    with pytest.raises(InputError, match="none"):
        Points(torch.zeros(0, 3), torch.zeros(0, 3))
    with pytest.raises(InputError, match=r"positions .* row 0"):
        Points(one * math.nan, one)
    with pytest.raises(InputError, match=r"normals .* row 0"):
        Points(one, one * math.inf)
    with pytest.raises(InputError, match=r"\[0, 1\]"):
        Points(one, one, albedo=3.0)
    with pytest.raises(InputError, match="vertex colours"):
        Points(one, one, albedo="vertex")
    with pytest.raises(InputError, match="2 rows"):
        Points(one, one, albedo=torch.ones(2, 1))


def test_a_point_that_cannot_be_lit_is_kept_so_that_rows_stay_in_place():
    points = Points(torch.zeros(3, 3), torch.tensor([[0.0, 0, 1], [0, 0, 0], [0, 0, 1]]))
    assert len(points.positions) == 3
    assert not points.normals[1].any()
