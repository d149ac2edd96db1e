"""Are normals what the surface says, at any scale, across seams and at creases?"""

import numpy as np
import pytest
import trimesh

from torchprt.scene.normals import corner_angles, face_normals, unit, vertex_normals

EPSILON = np.finfo(np.float64).eps
BALL = trimesh.creation.icosphere(subdivisions=3)
CUBE = trimesh.creation.box()


def soup(mesh):
    """Every corner a vertex of its own, as in an .stl file."""
    return mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


def test_no_faces_give_no_normals():
    assert not vertex_normals(np.ones((4, 3)), np.zeros((0, 3), dtype=np.int64)).any()


def test_a_cube_has_normals_along_its_diagonals_whatever_its_triangles():
    # Weighting by area or by face would favour the sides that are cut twice at a corner.
    normals = vertex_normals(CUBE.vertices, CUBE.faces)
    np.testing.assert_allclose(
        normals, CUBE.vertices / np.linalg.norm(CUBE.vertices, axis=1)[:, None], atol=4 * EPSILON
    )


def test_a_repeated_cube_stays_flat_and_a_repeated_ball_stays_smooth():
    positions, faces = soup(CUBE)
    np.testing.assert_allclose(
        vertex_normals(positions, faces).reshape(-1, 3, 3), CUBE.face_normals[:, None].repeat(3, 1), atol=4 * EPSILON
    )
    positions, faces = soup(BALL)
    whole = vertex_normals(BALL.vertices, BALL.faces)
    np.testing.assert_allclose(vertex_normals(positions, faces), whole[BALL.faces].reshape(-1, 3), atol=8 * EPSILON)


@pytest.mark.parametrize(("degrees", "smooth"), [(0, True), (59, True), (61, False), (120, False), (179, False)])
def test_a_seam_is_smooth_up_to_sixty_degrees(degrees, smooth):
    angle = np.radians(degrees)
    positions = np.array([[0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 0], [0, 1, 0], [np.cos(angle), 0, -np.sin(angle)]])
    normals = vertex_normals(positions, np.array([[0, 1, 2], [3, 5, 4]]))
    assert (np.abs(normals[0] - normals[3]).max() < 8 * EPSILON) == smooth
    assert (np.abs(normals[1] - normals[4]).max() < 8 * EPSILON) == smooth


def test_agrees_with_trimesh_on_a_scan(data):
    mesh = trimesh.load_mesh(data / "mesh" / "bunny.ply", process=False)
    ours = vertex_normals(np.array(mesh.vertices), np.array(mesh.faces))
    # trimesh weights by angle through the arc cosine, which is good to about 1e-8.
    np.testing.assert_allclose(ours, mesh.vertex_normals, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-150, 1e-30, 1e30, 1e150])
def test_scale_changes_nothing(scale):
    np.testing.assert_allclose(
        vertex_normals(BALL.vertices * scale, BALL.faces), vertex_normals(BALL.vertices, BALL.faces), atol=32 * EPSILON
    )


def test_faces_that_cancel_give_no_normal():
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]])
    assert not vertex_normals(triangle, np.array([[0, 1, 2], [2, 1, 0]])).any()


def test_faces_without_area_add_nothing():
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0.0]])
    normals = vertex_normals(positions, np.array([[0, 1, 2], [0, 1, 3], [0, 0, 0]]))
    np.testing.assert_array_equal(normals, [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 0]])
    assert not face_normals(positions, np.array([[0, 1, 3], [0, 0, 0]])).any()


def test_the_angles_of_a_triangle_add_up_to_half_a_turn():
    random = np.random.default_rng(0)
    positions = random.normal(size=(300, 3)) * 10.0 ** random.integers(-6, 6, size=(300, 1))
    angles = corner_angles(positions, np.arange(300).reshape(-1, 3))
    np.testing.assert_allclose(angles.sum(axis=1), np.pi, atol=16 * EPSILON)


def test_unit_is_exact_for_tiny_and_huge_vectors_and_zero_for_none():
    vectors = np.array([[3e-300, 0, 4e-300], [3e300, 0, 4e300], [0, 0, 0], [np.nan, 0, 1], [np.inf, 0, 0]])
    expected = [[0.6, 0, 0.8], [0.6, 0, 0.8], [0, 0, 0], [0, 0, 0], [0, 0, 0]]
    np.testing.assert_allclose(unit(vectors), expected, atol=2 * EPSILON)
