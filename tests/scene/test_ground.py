"""Does a ground lie where it should, fine where shadows are, and meet what stands on it along its outline?"""

import math

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene import Material, Object, Scene, make_mesh
from torchprt.scene.ground import BESIDE, GAP, REACH


def thing(mesh, **more):
    return Object(make_mesh(np.array(mesh.vertices), np.array(mesh.faces), name="thing"), **more)


def box(bottom=0.0, size=(1.0, 1.0, 1.0)):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation((0.3, bottom + size[1] / 2, -0.2))
    # Vertices enough that a side is not one triangle.
    return thing(mesh.subdivide().subdivide())


def disc_of(scene):
    return next(each.mesh for each in scene.objects if each.role == "ground")


# Misuse


@pytest.mark.parametrize(
    ("height", "words"), [(math.nan, "finite"), (-math.inf, "finite"), (1.0, "above 1"), (7.0, "above 1")]
)
def test_refuses_a_height_at_which_nothing_stands(height, words):
    with pytest.raises(InputError, match=words):
        Scene([box()]).on_ground(height)


@pytest.mark.parametrize("albedo", [-0.1, 1.5, math.nan])
def test_refuses_an_albedo_outside_zero_to_one(albedo):
    with pytest.raises(InputError, match="albedo"):
        Scene([box()]).on_ground(albedo=albedo)


def test_refuses_a_second_ground():
    with pytest.raises(InputError, match="a ground already"):
        Scene([box()]).on_ground().on_ground()


# Where it lies


def test_it_lies_just_below_the_lowest_point_and_faces_up():
    scene = Scene(
        [box(bottom=-3.0), thing(trimesh.creation.icosphere(2).apply_translation((0, -40, 0)), role="blocker")]
    )
    disc = disc_of(scene.on_ground(albedo=0.3))
    heights = disc.positions[:, 1].unique()
    # Of the receivers: a blocker may reach below.
    radius = 0.5 * 3**0.5
    assert len(heights) == 1
    assert -3 - 2 * GAP * radius < float(heights) < -3
    assert torch.equal(disc.normals, torch.tensor([0.0, 1.0, 0.0]).double().expand_as(disc.normals))
    a, b, c = disc.positions[disc.faces].unbind(1)
    assert bool((torch.linalg.cross(b - a, c - a)[:, 1] > 0).all())


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_it_is_the_same_at_any_scale(scale):
    def disc(factor):
        mesh = trimesh.creation.icosphere(3, radius=factor)
        return disc_of(Scene([thing(mesh)]).on_ground())

    one, other = disc(1.0), disc(scale)
    assert torch.equal(one.faces, other.faces)
    assert (one.positions * scale - other.positions).abs().max() < 1e-5 * scale * REACH


def test_it_fills_its_disc_without_holes_and_is_finest_below_the_model():
    disc = disc_of(Scene([box()]).on_ground())
    report = disc.report
    assert report.components == 1
    assert report.nonmanifold_edges == report.flipped_edges == report.degenerate_faces == report.duplicate_vertices == 0
    away = (disc.positions[:, [0, 2]] - torch.tensor([0.3, -0.2]).double()).norm(dim=-1)
    radius = 0.5 * 3**0.5
    assert float(away.max()) == pytest.approx(REACH * radius)
    rim = int((away > away.max() * (1 - 1e-6)).sum())
    assert report.boundary_edges == rim > 30
    a, b, c = disc.positions[disc.faces].unbind(1)
    area = torch.linalg.cross(b - a, c - a).norm(dim=-1) / 2
    assert float(area.sum()) == pytest.approx(math.pi * (REACH * radius) ** 2, rel=0.01)
    middle = away[disc.faces].mean(-1)
    near, far = area[middle < radius], area[middle > 4 * radius]
    assert float(near.median()) < 0.01 * float(far.median())


# What stands on it


def test_no_edge_leads_from_what_sees_the_sky_to_what_is_covered_far_from_the_outline():
    # The square of the box: x from -.2 to .8, z from -.7 to .3.
    disc = disc_of(Scene([box()]).on_ground())
    inside = torch.maximum((disc.positions[:, 0] - 0.3).abs(), (disc.positions[:, 2] + 0.2).abs()) - 0.5
    across = disc.faces[((inside[disc.faces] < 0).any(-1)) & ((inside[disc.faces] > 0).any(-1))]
    seeing = inside[across].clamp(min=0)
    radius = 0.5 * 3**0.5
    # Triangles that cross the outline begin beside it, but at the corners, which have no vertex of their own.
    corner = ((disc.positions[across] - torch.tensor([0.3, 0, -0.2]).double())[..., [0, 2]].abs().amin(-1) > 0.45).any(
        -1
    )
    assert len(across) > 100
    beside = seeing[~corner].flatten()
    assert float((beside > 2 * BESIDE * radius).double().mean()) < 0.02


def test_light_at_the_foot_of_a_wall_is_half_of_what_the_open_ground_gets():
    from torchprt.transport import bake

    # A wide, high box: the foot of its walls sees half of the sky.
    scene = Scene([thing(trimesh.creation.box((2, 6, 2)).subdivide().subdivide(), material=Material(0.0))]).on_ground()
    transfer = bake(scene, order=2, rays=256, progress=False)
    ground = transfer.receivers.ground()
    light = transfer.layers["diffuse"].signal.values[0, 0, ground] * 2 * math.pi**0.5
    places = transfer.positions[ground]
    away = torch.maximum(places[:, 0].abs(), places[:, 2].abs()) - 1
    along = torch.minimum(places[:, 0].abs(), places[:, 2].abs())
    foot = light[(away > 0) & (away < 0.05) & (along < 0.5)]
    assert len(foot) > 20
    # The walls end after 6 and 1 to either side: a little more than half is left. None is darker.
    assert float(foot.min()) > 0.47
    assert float(foot.max()) < 0.62
    assert float(light[away > 15].min()) > 0.9


def test_what_reaches_below_it_sees_nothing_from_beneath():
    from torchprt.transport import bake

    scene = Scene([thing(trimesh.creation.icosphere(3))]).on_ground(0.0)
    assert [each.role for each in scene.objects] == ["receiver", "ground", "blocker"]
    assert scene.objects[2].mesh.report.extent[1] > 1.5
    transfer = bake(scene, order=2, rays=256, progress=False, raw=True)
    below = ~transfer.receivers.ground() & (transfer.positions[:, 1] < -0.1)
    assert int(below.sum()) > 200
    assert float(transfer.layers["diffuse"].signal.values[..., below].abs().max()) == 0


def test_what_stands_on_it_is_lit_down_to_its_foot():
    from torchprt.transport import bake

    walls = trimesh.creation.box().subdivide().subdivide()
    walls.unmerge_vertices()
    transfer = bake(Scene([thing(walls)]).on_ground(), order=2, rays=256, progress=False)
    model = ~transfer.receivers.ground()
    side = transfer.normals[model][:, 1].abs() < 0.1
    light = transfer.layers["diffuse"].signal.values[0, 0, : int(model.sum())] * 2 * math.pi**0.5
    foot = side & (transfer.positions[model][:, 1] < -0.4999)
    # The upper half of what a wall sees; the ground is in the other half.
    assert int(foot.sum()) >= 16
    assert float((light[foot] - 0.5).abs().max()) < 0.03


# What a transfer knows of it


def test_a_transfer_says_which_receivers_are_ground_and_frames_the_others():
    from torchprt.transport import bake

    sheet = thing(trimesh.creation.icosphere(1), material=Material(0.5, two_sided=True))
    scene = Scene([sheet, box()]).on_ground()
    transfer = bake(scene, order=2, shadows=False)
    front, middle = len(sheet.mesh.positions), len(scene.objects[1].mesh.positions)
    whole = len(scene.objects[2].mesh.positions)
    assert [(each["name"], each["role"], each["side"], each["rows"]) for each in transfer.receivers.objects] == [
        ("thing", "receiver", "front", [0, front]),
        ("thing", "receiver", "front", [front, front + middle]),
        ("ground", "ground", "front", [front + middle, front + middle + whole]),
        ("thing", "receiver", "back", [front + middle + whole, 2 * front + middle + whole]),
    ]
    assert int(transfer.receivers.ground().sum()) == whole
    assert len(transfer.receivers.subject) == 2 * front + middle
    left = transfer.without_ground()
    alone = bake(Scene([sheet, scene.objects[1]]), order=2, shadows=False)
    assert torch.equal(left.positions, alone.positions)
    assert torch.equal(left.faces, alone.faces)
    assert torch.equal(left.layers["diffuse"].signal.values, alone.layers["diffuse"].signal.values)
    assert left.receivers.objects == alone.receivers.objects
    assert left.without_ground() is left
    assert not transfer.with_ground().receivers.ground().any()
