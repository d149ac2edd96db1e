"""Does every mesh get charts, and do they fit on a map with room between them?"""

import numpy as np
import pytest
import trimesh
from scipy.ndimage import distance_transform_edt
from texel_scenes import cube, plane

from torchprt.errors import InputError
from torchprt.scene import make_mesh
from torchprt.scene.pack import pack
from torchprt.scene.rasterise import overlap, rasterise
from torchprt.scene.unwrap import unwrap

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def arrays(mesh) -> tuple[np.ndarray, np.ndarray]:
    return mesh.positions.numpy(), mesh.faces.numpy()


def ball(level: int):
    """A sphere of triangles."""
    found = trimesh.creation.icosphere(subdivisions=level)
    return make_mesh(np.array(found.vertices), np.array(found.faces), name="ball")


def areas(places) -> np.ndarray:
    """Of triangles on a surface or on a map."""
    one, other = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    both = np.einsum("ij,ij->i", one, one) * np.einsum("ij,ij->i", other, other)
    return np.sqrt(np.maximum(both - np.einsum("ij,ij->i", one, other) ** 2, 0)) / 2


def charts_on(pairs, rows, columns) -> np.ndarray:
    """A map of the numbers of charts, -1 between them: faces with a corner at one place are one chart."""
    _, corner = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
    label = np.arange(corner.max() + 1)
    for _ in range(len(label)):
        lowest = np.full_like(label, len(label))
        np.minimum.at(lowest, corner.ravel(), np.repeat(label[corner.reshape(-1, 3)].min(1), 3))
        if (lowest == label).all():
            break
        label = lowest
    chart = label[corner.reshape(-1, 3)[:, 0]]
    raster = rasterise(pairs, chart, rows, columns, 1)
    found = np.full(rows * columns, -1)
    found[raster.texel] = chart[raster.face[:, 0]]
    return found.reshape(rows, columns)


# Misuse


def test_a_map_that_is_too_small_is_refused():
    pairs = unwrap(*arrays(cube()))
    with pytest.raises(InputError, match="no room between gutters of 8"):
        pack([pairs], 16, 16, 8)
    with pytest.raises(InputError, match="the charts do not fit on a map of 12 x 12 texels with gutters of 4"):
        pack([pairs], 12, 12, 4)


def test_what_no_face_has_area_in_is_refused():
    with pytest.raises(InputError, match="sheet cannot be unwrapped"):
        unwrap(np.outer([0, 1, 2], [1.0, 1, 1]), np.array([[0, 1, 2]]), "sheet")


# Shapes


@pytest.mark.parametrize(
    ("faces", "lost"),
    [
        ([[0, 1, 2]], []),
        ([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], []),
        ([[0, 1, 2], [0, 2, 1]], []),
        ([[0, 1, 2]] * 3, []),
        ([[0, 1, 2], [0, 1, 1], [3, 3, 3], [0, 1, 3]], [1, 2]),
        ([[1, 2, 0], [1, 2, 3], [2, 1, 3]], []),
    ],
    ids=["one", "closed", "both-sides", "three-times", "degenerate", "three-at-an-edge"],
)
def test_every_face_with_area_is_on_the_map_as_large_as_it_is(faces, lost):
    faces = np.array(faces)
    pairs = unwrap(CORNERS, faces)
    own = np.isfinite(pairs).all((1, 2))
    assert np.flatnonzero(~own).tolist() == lost
    assert areas(pairs[own]) == pytest.approx(areas(CORNERS[faces[own]]), rel=0.01)
    placed = pack([pairs], 64, 64, 2)[0]
    assert np.isfinite(placed[own]).all()
    # As large, relative to each other but for whole texels, of which a chart is wide; nothing on anything else.
    shares = areas(placed[own]) / areas(pairs[own])
    assert shares == pytest.approx(shares.mean(), rel=0.05)
    assert rasterise(placed, np.arange(len(faces)), 256, 256, 2).twice == 0


def test_a_part_that_is_far_smaller_than_the_rest_has_charts_too():
    positions, faces = arrays(ball(2))
    both = np.concatenate([positions * 1e-5, positions + 5])
    pairs = unwrap(both, np.concatenate([faces, faces + len(positions)]))
    assert np.isfinite(pairs).all()
    wide = [areas(each).sum() for each in np.split(pairs, 2)]
    assert wide[0] == pytest.approx(1e-10 * wide[1], rel=0.01)


@pytest.mark.parametrize("side", [slice(None), slice(None, None, -1)], ids=["again", "reverse"])
def test_a_surface_that_is_there_twice_has_its_charts_twice(side):
    positions, faces = arrays(ball(2))
    placed = pack([unwrap(positions, np.concatenate([faces, faces[:, side]]))], 128, 128, 2)[0]
    # Torn apart, of faces with gutters around each, it would fill a fiftieth of the map.
    assert areas(placed).sum() > 0.25
    assert overlap(placed, 256, 256) == 0


def test_a_curved_surface_keeps_its_areas_about():
    mesh = ball(3)
    pairs = unwrap(*arrays(mesh))
    stretch = areas(pairs) / areas(mesh.positions.numpy()[mesh.faces.numpy()])
    assert np.abs(np.log(stretch)).max() < 0.7


@pytest.mark.parametrize(
    "change", [lambda p: p * 1e-6, lambda p: p * 3e6, lambda p: p + 1e4], ids=["small", "large", "far"]
)
def test_neither_size_nor_place_changes_the_charts(change):
    positions, faces = arrays(ball(2))
    moved = change(positions)
    wanted = unwrap(positions, faces)
    found = unwrap(moved, faces) * np.ptp(positions) / np.ptp(moved)
    assert np.abs(found - wanted).max() < 1e-5 * np.abs(wanted).max()


def test_the_same_mesh_gives_the_same_bits():
    positions, faces = arrays(ball(3))
    assert np.array_equal(unwrap(positions, faces), unwrap(positions, faces))


# Maps


@pytest.mark.parametrize(("rows", "columns", "gutter"), [(96, 96, 3), (64, 160, 2), (200, 64, 1), (64, 64, 0)])
def test_between_charts_there_is_twice_the_gutter_and_once_to_the_border(rows, columns, gutter):
    parts = [unwrap(*arrays(mesh)) for mesh in (cube(), ball(2))]
    found = charts_on(np.concatenate(pack(parts, rows, columns, gutter)), rows, columns)
    assert len(np.unique(found)) > 6
    for number in np.unique(found[found >= 0]):
        away = distance_transform_edt(found != number)
        assert away[(found >= 0) & (found != number)].min() > 2 * gutter
    inner = found[gutter : rows - gutter, gutter : columns - gutter]
    assert (inner >= 0).sum() == (found >= 0).sum()


def test_objects_of_different_sizes_have_texels_of_one_size():
    small, large = (unwrap(*arrays(plane(2, -size, size))) for size in (0.5, 2.0))
    one, other = pack([small, large], 128, 128, 4)
    assert areas(other).sum() / areas(one).sum() == pytest.approx(16, rel=0.1)
    assert areas(np.concatenate([one, other])).sum() > 0.4


def test_faces_without_coordinates_stay_without():
    parts = [unwrap(*arrays(plane(2))), np.full((4, 3, 2), np.nan)]
    parts[0][1] = np.nan
    one, other = pack(parts, 32, 32, 1)
    assert np.isnan(other).all()
    assert np.isnan(one).any((1, 2)).tolist() == [False, True] + [False] * 6
