"""A profile turned about +y: positions, faces and texture coordinates of dishes and vases."""

import numpy as np
from jaxtyping import Float, Int


def smooth_profile(corners: list[tuple[float, float]], rows: int) -> Float[np.ndarray, "rows 2"]:
    """`rows` + 1 points (radius, height) at even distances along the smoothed corners, both ends where they were."""
    points = np.array(corners)
    # Chaikin's corner cutting tends to the quadratic B-spline; the ends stay.
    for _ in range(6):
        a, b = points[:-1], points[1:]
        cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
        points = np.concatenate([points[:1], cut, points[-1:]])
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    even = np.linspace(0, length[-1], rows + 1)
    return np.stack([np.interp(even, length, points[:, k]) for k in range(2)], axis=1)


def lathe(
    profile: Float[np.ndarray, "rows 2"], columns: int
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"], Float[np.ndarray, "F 3 2"]]:
    """Positions, faces and texture coordinates of a profile turned about +y; its ends are single vertices."""
    angle = 2 * np.pi * np.arange(columns) / columns
    radius, height = profile[1:-1].T
    around = np.stack([np.cos(angle), np.zeros(columns), -np.sin(angle)], axis=1)
    middle = radius[:, None, None] * around + height[:, None, None] * np.array([0.0, 1.0, 0.0])
    poles = np.array([[0.0, profile[0, 1], 0.0], [0.0, profile[-1, 1], 0.0]])
    positions = np.concatenate([middle.reshape(-1, 3), poles])
    rows = len(radius)
    bottom, top = len(positions) - 2, len(positions) - 1
    column = np.arange(columns)
    after = (column + 1) % columns
    j = np.arange(rows - 1)[:, None] * columns
    a, b, c, d = j + column, j + after, j + columns + after, j + columns + column
    faces = np.concatenate(
        [
            np.stack([a, b, c], -1).reshape(-1, 3),
            np.stack([a, c, d], -1).reshape(-1, 3),
            np.stack([np.full(columns, bottom), after, column], -1),
            np.stack([np.full(columns, top), (rows - 1) * columns + column, (rows - 1) * columns + after], -1),
        ]
    )
    vertex_u = np.concatenate([np.tile(column / columns, rows), [0.0, 0.0]])
    vertex_v = np.concatenate([np.repeat(np.arange(1, rows + 1) / (rows + 1), columns), [0.0, 1.0]])
    u = vertex_u[faces]
    fan = faces[:, 0] >= bottom
    u[fan, 0] = u[fan, 1]
    # The last column ends at u = 1, not 0; a pole lies in the middle of each of its faces.
    u = np.where((np.ptp(u, axis=1) > 0.5)[:, None] & (u < 0.5), u + 1, u)
    u[fan, 0] = u[fan, 1:].mean(axis=1)
    return positions, faces, np.stack([u, vertex_v[faces]], axis=-1)
