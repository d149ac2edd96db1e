"""Do tangents follow u where there is one, and turn little from neighbour to neighbour where there is none?"""

import os
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from torchprt.errors import InputError
from torchprt.scene import make_mesh, read_mesh
from torchprt.scene.samples import dish, organic
from torchprt.scene.tangents import smooth_tangents, tangents_from_uv

EPS = np.finfo(np.float64).eps
SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
UP = np.tile([0.0, 0, 1], (4, 1))


def frisvad(normals):
    """The usual frame made from the normal alone (Frisvad 2012, as mended by Duff et al. 2017)."""
    x, y, z = normals.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    return np.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x], axis=1)


def turning(mesh, tangents):
    """RMS angle in degrees between tangents of neighbours, brought to one plane by the least rotation of normals."""
    normals, faces = mesh.normals.numpy(), mesh.faces.numpy()
    pairs = np.unique(np.sort(np.concatenate([faces, np.roll(faces, 1, 1)]).reshape(-1, 3)[:, :2], axis=1), axis=0)
    i, j = pairs.T
    cosine = np.einsum("ij,ij->i", normals[i], normals[j])
    i, j, cosine = i[cosine > -0.5], j[cosine > -0.5], cosine[cosine > -0.5]
    along = np.einsum("ij,ij->i", normals[i], tangents[j]) / (1 + cosine)
    moved = tangents[j] - along[:, None] * (normals[i] + normals[j])
    angle = np.arctan2(np.linalg.norm(np.cross(tangents[i], moved), axis=1), np.einsum("ij,ij->i", tangents[i], moved))
    return np.degrees(np.sqrt((angle**2).mean()))


def arrays(mesh):
    return mesh.positions.numpy(), mesh.faces.numpy(), mesh.normals.numpy()


def is_frame(tangents, normals):
    lit = np.any(normals != 0, axis=1)
    assert np.abs(np.linalg.norm(tangents, axis=1) - 1).max() < 4 * EPS
    assert np.abs(np.einsum("ij,ij->i", tangents, normals))[lit].max(initial=0) < 4 * EPS


@pytest.fixture(scope="module")
def sculpture():
    return organic(10_000).objects[0].mesh


# Misuse


@pytest.mark.parametrize("shape", [(3, 2), (4, 3), (2, 3, 3), (1, 3, 2), (4,)])
def test_refuses_texture_coordinates_of_another_shape(shape):
    with pytest.raises(InputError, match=r"texture coordinates of shape .*give \[V, 2\] or \[F, 3, 2\]"):
        make_mesh(SQUARE, HALVES, uv=np.zeros(shape))


def test_refuses_tangents_that_are_too_few():
    with pytest.raises(InputError, match="2 tangents for 4 vertices"):
        make_mesh(SQUARE, HALVES, tangents=np.ones((2, 3)))


# From texture coordinates


@pytest.mark.parametrize("degrees", [0, 37, 90, 180, 271])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_tangents_point_to_where_u_increases(degrees, scale):
    angle = np.radians(degrees)
    along = np.array([np.cos(angle), np.sin(angle), 0])
    across = np.array([-np.sin(angle), np.cos(angle), 0])
    uv = scale * np.stack([SQUARE @ along, SQUARE @ across], axis=1)
    found = tangents_from_uv(SQUARE, HALVES, UP, uv[HALVES])
    np.testing.assert_allclose(found, np.tile(along, (4, 1)), atol=8 * EPS)


@pytest.mark.parametrize("scale", [1e-100, 1e-6, 1e6, 1e100])
def test_tangents_from_uv_do_not_depend_on_the_size_of_the_mesh(scale):
    uv = SQUARE[:, :2] @ np.array([[0.8, 0.6], [-0.6, 0.8]])
    one = tangents_from_uv(SQUARE, HALVES, UP, uv[HALVES])
    np.testing.assert_allclose(tangents_from_uv(scale * SQUARE, HALVES, UP, uv[HALVES]), one, atol=8 * EPS)


def test_mirrored_coordinates_turn_the_tangent_and_nothing_else():
    mirrored = SQUARE[:, :2] * [-1, 1]
    np.testing.assert_allclose(tangents_from_uv(SQUARE, HALVES, UP, mirrored[HALVES]), -UP[:, [2, 0, 1]], atol=EPS)
    upside_down = SQUARE[:, :2] * [1, -1]
    np.testing.assert_allclose(tangents_from_uv(SQUARE, HALVES, UP, upside_down[HALVES]), UP[:, [2, 0, 1]], atol=EPS)


@pytest.mark.parametrize("uv", [np.zeros((4, 2)), np.full((4, 2), np.nan), SQUARE[:, :1].repeat(2, axis=1)])
def test_coordinates_without_area_give_no_tangent(uv):
    assert not tangents_from_uv(SQUARE, HALVES, UP, uv[HALVES]).any()
    mesh = make_mesh(SQUARE, HALVES, uv=uv)
    assert mesh.tangents is None
    assert mesh.report.missing_tangents == 4
    assert "4 vertices whose texture coordinates give no tangent" in str(mesh.report)


def test_a_corner_averages_its_faces_by_their_angle_and_cancels_opposite_ones():
    corners = SQUARE[HALVES][..., :2].copy()
    corners[1] = corners[1] @ np.array([[0.0, 1], [-1, 0]])
    found = tangents_from_uv(SQUARE, HALVES, UP, corners)
    # Face 1 has u turned by 90 degrees; vertices 0 and 2 have 45 degrees of each.
    np.testing.assert_allclose(found[1], [1, 0, 0], atol=EPS)
    np.testing.assert_allclose(np.abs(found[[0, 2]]), np.tile([0.5**0.5, 0.5**0.5, 0], (2, 1)), atol=4 * EPS)
    corners[1] = -SQUARE[HALVES[1]][:, :2]
    found = tangents_from_uv(SQUARE, HALVES, UP, corners)
    assert not found[[0, 2]].any()
    assert found[[1, 3], 0].tolist() == [1, -1]


def test_a_missing_tangent_is_filled_from_its_neighbours():
    mesh = dish(24).objects[0].mesh
    missing = ~mesh.tangents.any(dim=1)
    assert missing.nonzero().flatten().tolist() == [len(mesh.positions) - 2, len(mesh.positions) - 1]
    field = mesh.tangent_field
    is_frame(field.numpy(), mesh.normals.numpy())
    # What the file says is kept up to the rounding of one more projection.
    np.testing.assert_allclose(field[~missing].numpy(), mesh.tangents[~missing].numpy(), atol=4 * EPS)


def test_around_a_lathe_u_goes_around_without_a_seam():
    mesh = dish(24).objects[0].mesh
    positions, tangents = mesh.positions[:-2].numpy(), mesh.tangents[:-2].numpy()
    around = np.stack([positions[:, 2], 0 * positions[:, 0], -positions[:, 0]], axis=1)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    # Chords of 48 columns on either side of a vertex are symmetric about it, but the diagonals are not.
    assert np.einsum("ij,ij->i", around, tangents).min() > 0.99


def test_given_tangents_come_before_texture_coordinates_and_are_made_orthogonal():
    given = np.array([[0.0, 5, 9], [0, 0, 0], [0, 0, 3], [np.nan, 0, 0]])
    mesh = make_mesh(SQUARE, HALVES, uv=SQUARE[:, :2], tangents=given)
    np.testing.assert_allclose(mesh.tangents.numpy(), [[0, 1, 0], [1, 0, 0], [1, 0, 0], [1, 0, 0]], atol=EPS)
    alone = make_mesh(SQUARE, HALVES, tangents=given)
    assert alone.report.missing_tangents == 3
    np.testing.assert_allclose(alone.tangent_field.numpy(), np.tile([0.0, 1, 0], (4, 1)), atol=1e-3)


# The smooth field


def test_every_vertex_gets_a_unit_tangent_orthogonal_to_its_normal(sculpture):
    is_frame(smooth_tangents(*arrays(sculpture)), sculpture.normals.numpy())


def test_the_field_turns_less_than_half_as_much_as_frames_from_normals_alone(sculpture):
    field = turning(sculpture, smooth_tangents(*arrays(sculpture)))
    alone = turning(sculpture, frisvad(sculpture.normals.numpy()))
    random = np.random.default_rng(0).normal(size=sculpture.normals.shape)
    random = np.cross(random, sculpture.normals.numpy())
    random = turning(sculpture, random / np.linalg.norm(random, axis=1, keepdims=True))
    assert field < 0.5 * alone < 0.25 * random


def test_the_field_on_the_scan_turns_a_quarter_as_much(data):
    scan = read_mesh(data / "mesh" / "bunny.ply")
    field = smooth_tangents(*arrays(scan))
    is_frame(field, scan.normals.numpy())
    assert turning(scan, field) < 0.25 * turning(scan, frisvad(scan.normals.numpy()))
    # The flat base, where frames about -z do well and frames about -y spin, is a field of one direction.
    base = scan.normals.numpy()[:, 1] < -0.99
    assert np.linalg.norm(field[base].mean(axis=0)) > 0.9


@pytest.mark.parametrize("scale", [1e-6, 1e6, 2.0**-200])
@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_the_field_depends_on_neither_scale_nor_place(sculpture, scale, offset):
    positions, faces, normals = arrays(sculpture)
    moved = scale * (positions + offset)
    np.testing.assert_array_equal(smooth_tangents(moved, faces, normals), smooth_tangents(positions, faces, normals))


def test_the_field_has_the_same_bits_for_any_number_of_threads():
    program = """
import hashlib
import numpy as np
from torchprt.scene.samples.grid import grid
from torchprt.scene.tangents import smooth_tangents
positions, faces = grid((0.0, 0.0, 0.0), (9.0, 0.0, 0.0), (0.0, 9.0, 0.0), 150, 150)
normals = np.stack([np.sin(positions[:, 0]), np.cos(3 * positions[:, 1]), 0.3 + 0 * positions[:, 0]], axis=1)
normals /= np.linalg.norm(normals, axis=1, keepdims=True)
print(hashlib.sha256(smooth_tangents(positions, faces, normals).tobytes()).hexdigest())
"""
    hashes = set()
    for threads in ("1", "3"):
        names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
        run = subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, **dict.fromkeys(names, threads)},
            capture_output=True,
            text=True,
            check=True,
        )
        hashes.add(run.stdout)
    assert len(hashes) == 1


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_plane_facing_anywhere_has_one_tangent(axis, sign):
    normal = sign * np.eye(3)[axis]
    along, across = np.roll(np.eye(3), axis, axis=0)[1:]
    positions = SQUARE[:, :1] * along + SQUARE[:, 1:2] * across
    field = smooth_tangents(positions, HALVES, np.tile(normal, (4, 1)))
    is_frame(field, np.tile(normal, (4, 1)))
    # The solver stops at a millionth.
    np.testing.assert_allclose(field, np.tile(field[0], (4, 1)), atol=1e-5)


def test_seams_do_not_part_the_field(sculpture):
    positions, faces, normals = arrays(sculpture)
    soup = faces.ravel()
    apart = smooth_tangents(positions[soup], np.arange(len(soup)).reshape(-1, 3), normals[soup])
    np.testing.assert_array_equal(apart, apart[np.unique(soup, return_index=True)[1]][soup])
    # The same graph in another order: the same field to the millionth at which the solver stops, but near poles.
    together = smooth_tangents(positions, faces, normals)
    assert np.median(np.einsum("ij,ij->i", apart, together[soup])) > 1 - 1e-6
    assert turning(sculpture, apart[np.unique(soup, return_index=True)[1]]) < 1.1 * turning(sculpture, together)


def test_kept_directions_stay_and_flow_into_the_rest():
    ball = trimesh.creation.icosphere(subdivisions=3)
    positions, faces = np.array(ball.vertices), np.array(ball.faces)
    normals = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    known = np.abs(positions[:, 1]) < 0.5
    around = np.cross([0.0, 1, 0], normals)
    around /= np.maximum(np.linalg.norm(around, axis=1, keepdims=True), 1e-9)
    field = smooth_tangents(positions, faces, normals, np.where(known[:, None], 5 * around, 0.0))
    np.testing.assert_allclose(field[known], around[known], atol=4 * EPS)
    ring = ~known & (np.abs(positions[:, 1]) < 0.75)
    assert np.einsum("ij,ij->i", field[ring], around[ring]).min() > 0.9


# Meshes as they come


def test_copes_with_what_is_not_a_surface():
    positions = np.array(
        [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [5, 5, 5], [5, 5, 5], [9, 9, 9], [1, 0, 0]]
    )
    # Three faces at one edge, one of them twice and turned over, one without area, vertices named by nothing.
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [1, 0, 4], [5, 6, 5], [0, 8, 2]])
    normals = np.array([[0.0, 0, 1]] * 4 + [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, -1, 0], [0, 0, -1]])
    is_frame(smooth_tangents(positions, faces, normals), normals)


def test_one_vertex_and_one_triangle():
    normals = np.array([[1.0, 0, 0]])
    is_frame(smooth_tangents(np.zeros((1, 3)), np.zeros((0, 3), dtype=np.int64), normals), normals)
    is_frame(smooth_tangents(SQUARE[:3], HALVES[:1], UP[:3]), UP[:3])


def test_a_guide_along_the_normal_says_nothing():
    field = smooth_tangents(SQUARE, HALVES, UP, 2 * UP)
    is_frame(field, UP)
    np.testing.assert_array_equal(field, smooth_tangents(SQUARE, HALVES, UP))


def test_a_sheet_whose_sides_share_positions_keeps_each_side_smooth():
    ticks = np.arange(9.0)
    x, y = np.meshgrid(ticks, ticks)
    sheet = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    corner = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    front = np.concatenate(
        [np.stack([corner, corner + 1, corner + 10], 1), np.stack([corner, corner + 10, corner + 9], 1)]
    )
    faces = np.concatenate([front, front[:, ::-1] + 81])
    normals = np.repeat([[0.0, 0, 1], [0, 0, -1]], 81, axis=0)
    field = smooth_tangents(np.concatenate([sheet, sheet]), faces, normals)
    is_frame(field, normals)
    np.testing.assert_allclose(field, np.tile([1.0, 0, 0], (162, 1)), atol=1e-5)
