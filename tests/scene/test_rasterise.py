"""Which texels do faces cover, and where are they sampled?"""

import numpy as np
import pytest

from torchprt.scene.rasterise import rasterise


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def first_face(uv: np.ndarray, rows: int, columns: int, across: int) -> np.ndarray:
    """By the definition: the first triangle that each sample of a grid lies in."""
    y, x = np.mgrid[0 : rows * across, 0 : columns * across]
    points = (np.stack([x, y], -1) + 0.5) / across
    found = np.full(points.shape[:2], -1)
    for number in reversed(range(len(uv))):
        a, b, c = uv[number] * [columns, rows]
        sides = np.stack([cross(b - a, points - a), cross(c - b, points - b), cross(a - c, points - c)])
        found[(sides >= 0).all(0) | (sides <= 0).all(0)] = number
    return found


def in_texels(found: np.ndarray, across: int) -> np.ndarray:
    rows, columns = found.shape[0] // across, found.shape[1] // across
    return found.reshape(rows, across, columns, across).transpose(0, 2, 1, 3).reshape(rows * columns, across**2)


def grid(count: int, low: float = 0.1, high: float = 0.9) -> np.ndarray:
    """A square of `count` x `count` cells of two triangles."""
    t = np.linspace(low, high, count + 1)
    cells = [(t[i], t[i + 1], t[j], t[j + 1]) for i in range(count) for j in range(count)]
    pairs = [[((a, c), (b, c), (b, d)), ((a, c), (b, d), (a, d))] for a, b, c, d in cells]
    return np.array([triangle for pair in pairs for triangle in pair])


def one(uv: np.ndarray) -> np.ndarray:
    return np.zeros(len(uv), int)


def test_nothing_covers_nothing() -> None:
    found = rasterise(np.zeros((0, 3, 2)), np.zeros(0, int), 4, 4)
    assert len(found.texel) == 0
    assert found.twice == 0


@pytest.mark.parametrize("across", [1, 2, 3])
def test_samples_are_of_the_first_face_that_they_lie_in(across: int) -> None:
    uv = np.random.default_rng(0).random((12, 3, 2))
    found = rasterise(uv, one(uv), 11, 17, across)
    expected = in_texels(first_face(uv, 11, 17, across), across)
    inside = (expected >= 0).any(1)
    assert np.array_equal(found.texel[found.own.any(1)], np.flatnonzero(inside))
    here = expected[found.texel]
    assert np.array_equal(found.own, here >= 0)
    assert np.array_equal(found.face[found.own], here[found.own])


def test_weights_lead_back_to_the_places_of_the_samples() -> None:
    uv = np.random.default_rng(1).random((6, 3, 2))
    found = rasterise(uv, one(uv), 16, 16, 2)
    places = (found.weights[..., None] * uv[found.face]).sum(2) * 16
    corner = np.stack([found.texel % 16, found.texel // 16], -1)[:, None]
    regular = np.array([[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]])
    assert np.abs(places - corner - regular)[found.own].max() < 1e-5, "of float32 weights"
    # The others stand for some of the same texel.
    assert np.abs(places - corner - 0.5).max() < 0.72


def test_every_texel_that_a_face_touches_is_covered() -> None:
    uv = np.random.default_rng(2).random((4, 3, 2)) * 0.4 + 0.3
    fine = in_texels(first_face(uv, 13, 13, 24), 24)
    assert not np.setdiff1d(np.flatnonzero((fine >= 0).any(1)), rasterise(uv, one(uv), 13, 13, 1).texel).size


def test_an_edge_on_the_border_of_a_texel_does_not_touch_the_next() -> None:
    square = grid(1, 0.25, 0.75)
    found = rasterise(square, one(square), 8, 8, 2)
    assert len(found.texel) == 16
    assert found.own.all()


def test_faces_side_by_side_leave_no_gap_and_do_not_overlap() -> None:
    uv = grid(13)
    found = rasterise(uv, one(uv), 70, 70, 3)
    assert found.twice == 0
    inner = np.stack([found.texel % 70, found.texel // 70], -1)
    inner = ((inner > 7) & (inner < 62)).all(1)
    assert found.own[inner].all()


def test_an_overlap_is_counted() -> None:
    uv = np.concatenate([grid(1, 0.0, 0.5), grid(1, 0.25, 0.75)])
    found = rasterise(uv, one(uv), 16, 16, 2)
    assert found.twice == 16


def test_a_face_smaller_than_a_texel_has_one_and_a_second_in_it_is_lost() -> None:
    small = np.array([[[0.52, 0.52], [0.53, 0.52], [0.52, 0.53]]])
    found = rasterise(np.concatenate([small, small + 0.02]), np.array([0, 1]), 4, 4)
    assert found.texel.tolist() == [10]
    assert found.face[0, 0] == 1, "the nearer to the middle"
    assert found.lost.tolist() == [True, False]


def test_a_face_without_area_on_the_map_is_sampled_along_its_length() -> None:
    line = np.array([[[0.1, 0.3], [0.9, 0.3], [0.5, 0.3]]])
    assert rasterise(line, one(line), 8, 8).texel.tolist() == [2 * 8 + column for column in range(8)]


def test_a_texel_is_of_the_chart_that_most_of_it_is_in() -> None:
    left, right = grid(1, 0.0, 1.0), grid(1, 0.0, 1.0)
    left[..., 0] *= 0.6
    right[..., 0] = 0.6 + 0.4 * right[..., 0]
    found = rasterise(np.concatenate([left, right]), np.array([0, 0, 1, 1]), 2, 2, 5)
    assert (found.face < 2).all(1).tolist() == [True, False, True, False]
    assert ((found.face < 2).all(1) | (found.face >= 2).all(1)).all()


def test_what_is_missing_or_outside_of_the_square_covers_nothing() -> None:
    uv = np.concatenate([np.full((1, 3, 2), np.nan), grid(1, 1.5, 2.5), grid(1, -0.5, 0.5)])
    found = rasterise(uv, one(uv), 4, 4)
    assert found.texel.tolist() == [0, 1, 4, 5]
    assert not found.lost[0]
