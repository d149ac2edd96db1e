"""Are the samples the scenes that they say they are?"""

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene import load
from torchprt.scene.samples import (
    coloured_box,
    dish,
    organic,
    painted_vase,
    plane_and_blocker,
    teapot,
    vase_picture,
    write_painted_vase,
)
from torchprt.scene.samples.surface_nets import surface_nets


@pytest.mark.parametrize(
    "make",
    [
        lambda: organic(7999),
        lambda: plane_and_blocker(0),
        lambda: coloured_box(3),
        lambda: teapot(7999),
        lambda: dish(15),
        lambda: painted_vase(15),
    ],
)
def test_refuses_too_little_detail(make):
    with pytest.raises(InputError, match="give at least"):
        make()


@pytest.mark.parametrize("make", [teapot, dish])
def test_refuses_a_material_that_is_none(make):
    with pytest.raises(InputError, match="material 'glass'"):
        make(material="glass")


@pytest.fixture(scope="module")
def sculpture():
    return organic(8000).objects[0].mesh


def test_the_sculpture_is_closed_and_stands_on_the_ground(sculpture):
    report = sculpture.report
    assert report.watertight
    assert report.components == 1
    assert report.degenerate_faces == report.missing_normals == report.duplicate_vertices == 0
    assert abs(report.vertices - 8000) <= 160
    assert abs(sculpture.positions[:, 1].min()) < 0.05


def test_the_sculpture_shows_its_outside(sculpture):
    corners = sculpture.positions[sculpture.faces]
    volume = (corners[:, 0] * torch.linalg.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume > 0


def test_the_sculpture_has_well_shaped_triangles(sculpture):
    peer = trimesh.Trimesh(sculpture.positions.numpy(), sculpture.faces.numpy(), process=False)
    assert np.degrees(np.median(peer.face_angles.min(axis=1))) > 35


def test_the_sculpture_is_the_same_every_time(sculpture):
    assert torch.equal(organic(8000).objects[0].mesh.positions, sculpture.positions)


def test_the_blocker_stands_above_a_plane_that_faces_it():
    plane, blocker = plane_and_blocker(16).objects
    assert (plane.role, blocker.role) == ("receiver", "blocker")
    assert torch.equal(plane.mesh.normals, torch.tensor([[0.0, 1, 0]], dtype=torch.float64).expand(17 * 17, 3))
    assert (blocker.mesh.positions[:, 1] > plane.mesh.positions[:, 1].max()).all()
    assert len(blocker.mesh.faces) == 2


def test_the_box_has_its_red_wall_to_the_left_and_faces_inward():
    scene = coloured_box(8)
    named = {each.mesh.name: each for each in scene.objects}
    red, green = named["red wall"], named["green wall"]
    assert (red.mesh.positions[:, 0] == -1).all()
    assert (green.mesh.positions[:, 0] == 1).all()
    assert red.albedo[0].argmax() == 0
    assert green.albedo[0].argmax() == 1
    for wall in (red, green, named["room"]):
        centres = wall.mesh.positions[wall.mesh.faces].mean(dim=1)
        corners = wall.mesh.positions[wall.mesh.faces]
        facing = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert ((facing * centres).sum(dim=1) < 0).all()
    assert scene.requires(1).channels == 3
    inside = torch.cat([named[name].mesh.positions for name in ("block", "sphere")])
    assert inside.abs().max() <= 1


def test_nets_around_a_ball_lie_on_it_and_close():
    positions, faces = surface_nets(lambda p: p.norm(dim=1) - 1, np.full(3, -1.3), np.full(3, 1.3), 0.1)
    # Points are moved in float32.
    assert np.abs(np.linalg.norm(positions, axis=1) - 1).max() < 1e-5
    peer = trimesh.Trimesh(positions, faces, process=False)
    assert peer.is_watertight
    assert peer.euler_number == 2
    # Triangles lie inside the ball by about the square of their size.
    assert peer.volume == pytest.approx(4 / 3 * np.pi, rel=0.01)


def test_nets_stay_manifold_where_sheets_meet_in_one_cell():
    def balls(points):
        first = (points - torch.tensor([0.52, 0.5, 0.47])).norm(dim=1) - 0.9
        return torch.minimum(first, (points + torch.tensor([0.5, 0.53, 0.5])).norm(dim=1) - 0.84)

    counts = []
    for cell in (0.31, 0.2, 0.17, 0.11):
        _, faces = surface_nets(balls, np.full(3, -1.7), np.full(3, 1.7), cell, relaxations=0)
        sides = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        counts += np.unique(sides, axis=0, return_counts=True)[1].tolist()
    assert set(counts) == {2}


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_samples_do_not_care_whether_gradients_are_recorded(mode):
    with mode():
        quiet = organic(8000).geometry().positions
    assert torch.equal(quiet, organic(8000).geometry().positions)


@pytest.fixture(scope="module")
def pot():
    return teapot(8000).objects[0]


def test_the_teapot_is_closed_glossy_and_stands_on_the_ground(pot):
    report = pot.mesh.report
    assert report.watertight
    assert not report.inside_out
    assert report.components == 1
    assert report.degenerate_faces == report.missing_normals == report.duplicate_vertices == 0
    assert abs(report.vertices - 8000) <= 160
    assert abs(pot.mesh.positions[:, 1].min()) < 0.01
    assert pot.material.brdf.spec == "ggx:0.3"
    peer = trimesh.Trimesh(pot.mesh.positions.numpy(), pot.mesh.faces.numpy(), process=False)
    # One handle: the hole between it and the body.
    assert peer.euler_number == 0
    assert np.degrees(np.median(peer.face_angles.min(axis=1))) > 35


def test_the_body_of_the_teapot_faces_its_spout(pot):
    peer = trimesh.Trimesh(pot.mesh.positions.numpy(), pot.mesh.faces.numpy(), process=False)
    # A ray from the body, up and outward, meets the spout; on the other side, the handle; to the front, nothing.
    starts, ways = [[0.87, 0.75, 0.0], [-0.87, 0.75, 0.0], [0.0, 0.75, 0.87]], [[1, 0, 0], [-1, 0, 0], [0, 0, 1.0]]
    met = peer.ray.intersects_any(np.array(starts), np.array(ways))
    assert met.tolist() == [True, True, False]


def test_the_knob_shades_the_lid(pot):
    peer = trimesh.Trimesh(pot.mesh.positions.numpy(), pot.mesh.faces.numpy(), process=False)
    lid = np.array([[0.25, 1.23, 0.0], [0.0, 1.23, -0.25]])
    way = np.array([[0.0, 1.38, 0.0]]) - lid
    assert peer.ray.intersects_any(lid, way).all()
    assert not peer.ray.intersects_any(lid, -way * [1, -1, 1]).any()


def test_the_teapot_takes_a_material():
    assert teapot(8000, "membrane:0.5").objects[0].material.translucency == 0.5


@pytest.fixture(scope="module")
def plate():
    return dish(24).objects[0]


def test_the_dish_is_closed_brushed_and_stands_on_the_ground(plate):
    report = plate.mesh.report
    assert report.watertight
    assert not report.inside_out
    assert report.components == 1
    assert report.degenerate_faces == report.missing_normals == report.duplicate_vertices == 0
    assert report.missing_tangents == 2
    assert float(plate.mesh.positions[:, 1].min()) == 0
    assert not plate.material.brdf.isotropic
    assert plate.tangent_field == "uv"


@pytest.mark.parametrize(("resolution", "vertices"), [(16, 482), (128, 32514)])
def test_the_dish_has_the_vertices_it_promises(resolution, vertices):
    assert len(dish(resolution).objects[0].mesh.positions) == vertices


def test_the_knob_of_the_dish_shades_its_inside(plate):
    peer = trimesh.Trimesh(plate.mesh.positions.numpy(), plate.mesh.faces.numpy(), process=False)
    floor = np.array([[0.5, 0.1, 0.0], [0.0, 0.1, 0.5]])
    way = np.array([[0.0, 0.33, 0.0]]) - floor
    assert peer.ray.intersects_any(floor, way).all()
    assert not peer.ray.intersects_any(floor, np.tile([0.0, 1, 0], (2, 1))).any()


def test_the_painted_vase_is_the_same_from_its_file(tmp_path):
    here = painted_vase(24).objects[0]
    write_painted_vase(tmp_path / "vase.glb", 24)
    there = load(tmp_path / "vase.glb").objects[0]
    assert here.mesh.report.watertight
    assert there.mesh.report.watertight
    # Vertices at the seam and at the gold are repeated: each is compared with the one at its place.
    place = torch.cdist(there.mesh.positions, here.mesh.positions).argmin(1)
    assert float((there.mesh.positions - here.mesh.positions[place]).norm(dim=1).max()) < 1e-6
    difference = (there.albedo - here.albedo[place]).abs().amax(1)
    # Where porcelain meets gold, one mesh has one colour and the other two.
    assert float((difference < 1 / 255).float().mean()) > 0.9
    said = str(load(tmp_path / "vase.glb"))
    assert "textures of 'porcelain', base colour of 'gold'" in said


def test_the_picture_of_the_vase_meets_itself():
    picture = vase_picture(256)
    assert picture.shape == (256, 256, 3)
    across = np.abs(picture[:, 0].astype(int) - picture[:, -1])
    inside = np.abs(np.diff(picture.astype(int), axis=1)).max(axis=1)
    assert (across <= inside + 1).all()


def test_a_vase_goes_to_a_glb_only(tmp_path):
    with pytest.raises(InputError, match=r"must end in \.glb"):
        write_painted_vase(tmp_path / "vase.ply", 24)


def test_only_the_gold_of_the_vase_is_polished():
    geometry = painted_vase(16, polished=True).geometry()
    assert [brdf.spec for brdf in geometry.gloss] == ["ggx:0.2"]
    assert 0 < len(geometry.glossy) < geometry.receivers / 2
    assert not geometry.albedo[geometry.glossy].any()
    assert geometry.specular.unique(dim=0).tolist() == [pytest.approx([1.0, 0.766, 0.336])]
