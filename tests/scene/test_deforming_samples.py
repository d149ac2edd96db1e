"""Are the samples that deform the surfaces that they say they are?"""

import numpy as np
import pytest
import torch
import trimesh

from torchprt.errors import InputError
from torchprt.scene.samples import cylinder, flap, head, vase, wing, wing_rig, wing_translucency


@pytest.mark.parametrize(
    "make", [lambda: head(5999), lambda: vase(15), lambda: cylinder(3), lambda: wing(15), lambda: wing_rig(15)]
)
def test_refuses_too_little_detail(make):
    with pytest.raises(InputError, match="give at least"):
        make()


@pytest.fixture(scope="module")
def carved():
    return head(6000).objects[0].mesh


def test_the_head_is_one_closed_surface_with_its_features(carved):
    report = carved.report
    assert report.watertight
    assert not report.inside_out
    assert report.components == 1
    assert report.degenerate_faces == report.missing_normals == report.duplicate_vertices == 0
    assert abs(report.vertices - 6000) <= 120
    # The nose stands out beyond brow and lips, the sockets lie behind the brow.
    peer = trimesh.Trimesh(carved.positions.numpy(), carved.faces.numpy(), process=False)
    starts = np.array([[0.0, 1.08, 3.0], [0.0, 1.4, 3.0], [0.0, 0.886, 3.0], [0.1, 1.37, 3.0], [0.1, 1.25, 3.0]])
    depth = peer.ray.intersects_location(starts, np.tile([0, 0, -1.0], (5, 1)), multiple_hits=False)
    z = np.empty(5)
    z[depth[1]] = depth[0][:, 2]
    nose, forehead, mouth, brow, socket = z
    assert nose > forehead + 0.1
    assert nose > mouth + 0.1
    assert brow > socket


def test_the_head_is_the_same_every_time(carved):
    assert torch.equal(head(6000).objects[0].mesh.positions, carved.positions)


def test_the_vase_is_closed_and_its_outside_ends_where_it_says():
    mesh = vase(64).objects[0].mesh
    assert mesh.report.watertight
    assert not mesh.report.inside_out
    assert mesh.uv is not None
    assert float(mesh.uv.min()) == 0
    assert float(mesh.uv.max()) == 1
    rim = mesh.faces == mesh.positions[:, 1].argmax()
    assert float(mesh.uv[rim][0, 1]) == pytest.approx(0.54, abs=0.01)


def test_the_cylinder_meets_itself():
    mesh = cylinder(8).objects[0].mesh
    assert mesh.report.components == 1
    assert mesh.report.duplicate_vertices == 0
    assert mesh.report.boundary_edges == 2 * 16
    assert float(mesh.uv.amax()) == 1
    # Texture coordinates go on through the seam: no face is wider than a column.
    assert float((mesh.uv.amax(1) - mesh.uv.amin(1)).max()) == pytest.approx(1 / 16)
    # Tangents run around, v runs up: u x v points out.
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand_as(mesh.normals)
    assert float((torch.linalg.cross(mesh.tangents, up) - mesh.normals).norm(dim=1).max()) < 1e-12


@pytest.fixture(scope="module")
def wings():
    return wing(32), wing_rig(32)


def test_the_wings_mirror_each_other_and_face_up(wings):
    mesh = wings[0].objects[0].mesh
    assert mesh.report.components == 1
    assert mesh.report.degenerate_faces == 0
    assert float(mesh.normals[:, 1].min()) > 0
    mirrored = mesh.positions * torch.tensor([-1.0, 1.0, 1.0])
    assert float(torch.cdist(mirrored, mesh.positions).min(1).values.max()) < 1e-6


def test_the_wings_record_on_both_sides_and_let_light_through(wings):
    geometry = wings[0].geometry()
    through = wing_translucency(32)
    assert geometry.receivers == len(through) == len(wings[1].weights) == 2 * len(geometry.positions)
    assert float(through.max()) == pytest.approx(0.55, abs=1e-3)
    assert float(through.min()) < 0.1
    # Pure red light reflected and let through is no more than came.
    assert bool((geometry.albedo.amax(1) * (1 + through) <= 1).all())


def test_weights_of_the_wing_are_shares(wings):
    weights = wings[1].weights
    assert bool((weights >= 0).all())
    assert (weights.sum(1) - 1).abs().max() < 1e-12


def test_a_beat_raises_and_lowers_both_wings_alike(wings):
    scene, rig = wings
    positions = scene.geometry().receiver_positions
    homogeneous = torch.cat([positions, torch.ones(len(positions), 1)], 1)
    matrices = rig.pose(flap(torch.tensor([0.0, 0.5], dtype=torch.float64)))
    moved = torch.einsum("vj,bjxy,vy->bvx", rig.weights, matrices, homogeneous)[..., :3]
    left, right = positions[:, 0].argmin(), positions[:, 0].argmax()
    assert bool((moved[0, [left, right], 1] > 1).all())
    assert bool((moved[1, [left, right], 1] < -0.5).all())
    assert (moved[:, left, 1] - moved[:, right, 1]).abs().max() < 1e-9
