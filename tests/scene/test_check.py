"""Does the report count what is there, at any scale and place?"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from torchprt.scene import make_mesh, read_mesh
from torchprt.scene.check import degenerate

CUBE = trimesh.creation.box()


def report(positions, faces):
    return make_mesh(np.asarray(positions), np.asarray(faces)).report


def test_a_cube_is_closed():
    found = report(CUBE.vertices, CUBE.faces)
    assert (found.vertices, found.faces, found.components) == (8, 12, 1)
    assert found.watertight
    assert found.extent == (1, 1, 1)
    assert "closed and consistently wound" in str(found)


def test_a_single_face_has_three_open_edges():
    found = report([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]], [[0, 1, 2]])
    assert found.boundary_edges == 3
    assert not found.watertight


def test_a_seam_is_not_a_hole():
    found = report(CUBE.vertices[CUBE.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert found.watertight
    assert found.components == 1
    assert found.duplicate_vertices == 28


def test_zero_and_minus_zero_are_one_position():
    found = report([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, -0.0], [1, 0, 0], [0, 0, 1]], [[0, 1, 2], [4, 3, 5]])
    assert found.duplicate_vertices == 2
    assert found.boundary_edges == 4


def test_a_removed_face_leaves_three_open_edges():
    assert report(CUBE.vertices, CUBE.faces[1:]).boundary_edges == 3


def test_a_turned_face_disagrees_with_its_three_neighbours():
    faces = CUBE.faces.copy()
    faces[4] = faces[4, ::-1]
    found = report(CUBE.vertices, faces)
    assert found.flipped_edges == 3
    assert "opposite senses" in str(found)


def test_three_faces_at_an_edge_are_counted_once():
    fan = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0.0]]
    found = report(fan, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert found.nonmanifold_edges == 1
    assert found.boundary_edges == 6


def test_degenerate_faces_and_loose_vertices_are_kept_and_counted():
    positions = np.concatenate([CUBE.vertices, [[3.0, 3, 3]]])
    faces = np.concatenate([CUBE.faces, [[0, 0, 1], [2, 2, 2]]])
    mesh = make_mesh(positions, faces)
    assert mesh.report.degenerate_faces == 2
    assert mesh.report.unreferenced_vertices == 1
    assert (mesh.report.missing_normals, mesh.report.dark_vertices) == (1, 1)
    assert len(mesh.faces) == 14
    assert "1 vertex of no face and no normal: will receive no light." in str(mesh.report)
    assert "turned or filled" not in str(mesh.report)


def test_what_is_said_of_vertices_without_a_normal_is_what_a_bake_makes_of_them():
    """One hangs on a corner by a face without area, one by nothing."""
    from torchprt.scene import Object, Scene
    from torchprt.transport import bake

    positions = np.concatenate([CUBE.vertices, CUBE.vertices[:1], [[3.0, 3, 3]]])
    mesh = make_mesh(positions, np.concatenate([CUBE.faces, [[8, 0, CUBE.faces[0, 0] or CUBE.faces[0, 1]]]]))
    assert (mesh.report.missing_normals, mesh.report.dark_vertices) == (2, 1)
    assert "1 vertex of faces without a usable normal: turned or filled by a bake" in str(mesh.report)
    assert "1 vertex of no face and no normal: will receive no light." in str(mesh.report)
    baked = [
        bake(Scene([Object(mesh)]), order=2, rays=64, threads=1, progress=False, **how)
        .layers["diffuse"]
        .signal.values[0]
        .abs()
        .amax(0)
        for how in ({}, {"raw": True}, {"shadows": False})
    ]
    assert baked[0][8] > 0.1
    assert all(each[9] == 0 for each in baked)
    assert baked[1][8] == baked[2][8] == 0


def test_normals_that_point_inward_are_reported_and_kept():
    normals = -CUBE.vertices
    mesh = make_mesh(CUBE.vertices, CUBE.faces, normals)
    assert mesh.report.opposed_normals == 8
    assert mesh.report.computed_normals == 0
    assert (mesh.normals.numpy() * CUBE.vertices < 0).all()


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1.0, 1e6, 1e30])
def test_the_verdict_does_not_depend_on_scale(data, scale):
    mesh = read_mesh(data / "mesh" / "teapot.ply")
    whole = make_mesh(mesh.positions, mesh.faces).report
    found = make_mesh(mesh.positions * scale, mesh.faces).report
    assert whole.boundary_edges > 0
    assert replace(found, extent=(0.0, 0.0, 0.0)) == replace(whole, extent=(0.0, 0.0, 0.0))


def test_the_verdict_does_not_depend_on_place(data):
    mesh = read_mesh(data / "mesh" / "bunny.ply")
    found = make_mesh(mesh.positions + 1e4, mesh.faces).report
    assert replace(found, extent=(0.0, 0.0, 0.0)) == replace(mesh.report, extent=(0.0, 0.0, 0.0))


@pytest.mark.parametrize(("height", "flat"), [(0.0, True), (1e-9, True), (1e-5, False), (1.0, False)])
@pytest.mark.parametrize("scale", [1e-150, 1e-6, 1e6, 1e150])
@pytest.mark.parametrize("corner", [0, 1, 2])
def test_thin_faces_are_judged_beside_their_own_length(height, flat, scale, corner):
    triangle = np.roll(np.array([[0, 0, 0], [1, 0, 0], [0.3, height, 0]]), corner, axis=0) * scale
    assert degenerate(triangle, np.array([[0, 1, 2]])).tolist() == [flat]


def test_agrees_with_trimesh_on_a_scan(data):
    mesh = read_mesh(data / "mesh" / "bunny.ply")
    peer = trimesh.Trimesh(mesh.positions.numpy(), mesh.faces.numpy(), process=False)
    assert mesh.report.watertight == (peer.is_watertight and peer.is_winding_consistent)
    assert mesh.report.components == peer.body_count
    boundary = np.unique(peer.edges_sorted, axis=0, return_counts=True)[1]
    assert mesh.report.boundary_edges == (boundary == 1).sum()
    assert mesh.report.nonmanifold_edges == (boundary > 2).sum()


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-6, 0.0), (1e6, 0.0), (1.0, 1e4)])
def test_a_body_whose_faces_look_inward_is_inside_out(scale, shift):
    ball = trimesh.creation.icosphere(subdivisions=2)
    positions = ball.vertices * scale + shift
    inward = make_mesh(positions, ball.faces[:, ::-1].copy())
    assert inward.report.inside_out
    assert "inside out" in str(inward.report)
    assert not make_mesh(positions, ball.faces).report.inside_out


def test_a_sheet_with_two_sides_is_not_inside_out():
    positions = np.random.default_rng(0).normal(size=(3, 3))
    assert not make_mesh(positions, np.array([[0, 1, 2], [2, 1, 0]])).report.inside_out
