"""Small surfaces with texture coordinates, for bakes at texels."""

from __future__ import annotations

import numpy as np

from torchprt.scene import Material, Mesh, Object, make_mesh

SQUARE = np.array([[0, 2, 1], [0, 3, 2]])


def plane(
    count: int = 1,
    low: float = -1.0,
    high: float = 1.0,
    uv: tuple[float, float, float, float] = (0.1, 0.1, 0.9, 0.9),
    height: float = 0.0,
    name: str = "plane",
) -> Mesh:
    """A horizontal square that looks up, of `count` x `count` cells; u along x, v along z, from and to `uv`."""
    t = np.linspace(0, 1, count + 1)
    x, z = np.meshgrid(t, t, indexing="ij")
    places = np.stack([low + (high - low) * x, np.full_like(x, height), low + (high - low) * z], -1).reshape(-1, 3)
    pairs = np.stack([uv[0] + (uv[2] - uv[0]) * x, uv[1] + (uv[3] - uv[1]) * z], -1).reshape(-1, 2)
    at = np.arange((count + 1) ** 2).reshape(count + 1, count + 1)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], -1).reshape(-1, 4)
    return make_mesh(places, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]), uv=pairs, name=name)


def card(size: float = 0.5, height: float = 0.4) -> Object:
    """A black horizontal square above."""
    corners = np.array([[-size, height, -size], [size, height, -size], [size, height, size], [-size, height, size]])
    return Object(make_mesh(corners, SQUARE, name="card"), Material(0.0), "blocker")


def cube(size: float = 1.0, gap: float = 0.04, inward: bool = False, name: str = "cube") -> Mesh:
    """A cube around the origin with a chart a side, three beside each other in two rows with `gap` around each."""
    places, faces, pairs = [], [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            number = len(places)
            normal = np.zeros(3)
            normal[axis] = side
            right = np.roll(normal, 1) * side
            up = np.cross(normal, right)
            corners = [normal + a * right + b * up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
            places.append(np.stack(corners) * size / 2)
            column, row = axis, int(side > 0)
            low = np.array([column / 3 + gap, row / 2 + gap])
            high = np.array([(column + 1) / 3 - gap, (row + 1) / 2 - gap])
            a, b = low, high
            pairs.append(np.array([[a[0], b[1]], [b[0], b[1]], [b[0], a[1]], [a[0], a[1]]]))
            quad = np.array([[0, 1, 2], [0, 2, 3]]) + 4 * number
            faces.append(quad[:, ::-1] if inward else quad)
    return make_mesh(np.concatenate(places), np.concatenate(faces), uv=np.concatenate(pairs), name=name)


def halves() -> Mesh:
    """A flat sheet of 2 x 1, cut in the middle: the left half upright on the map, the right one turned and smaller."""
    places = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [1, 0, 0], [2, 0, 0], [2, 0, 1], [1, 0, 1]], float)
    left = [(0.1 + 0.3 * x, 0.1 + 0.3 * z) for x, _, z in places[:4]]
    right = [(0.55 + 0.25 * z, 0.83 - 0.23 * (x - 1)) for x, _, z in places[4:]]
    return make_mesh(places, np.concatenate([SQUARE, SQUARE + 4]), uv=np.array(left + right), name="halves")


def column(sides: int = 24) -> Mesh:
    """The mantle of a column of height 1 and radius .1, smooth, in two charts: its halves, one upright on the map, one
    lying; each side of it is narrower than a texel of a map of 64."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], -1)
    half = sides // 2
    places, normals, pairs, faces = [], [], [], []
    for part, (first, last) in enumerate(((0, half), (half, sides))):
        some = ring[first : last + 1]
        # The last of one half is the first of the other, to the bit.
        some = np.where(np.arange(first, last + 1)[:, None] % sides == 0, ring[0], some)
        along = np.linspace(0, 1, len(some))
        start = sum(map(len, places))
        for height in (0.0, 1.0):
            places.append(0.1 * some + [0, height, 0])
            normals.append(some)
            across = np.full_like(along, height)
            upright = np.stack([0.1 + 0.15 * along, 0.9 - 0.7 * across], -1)
            lying = np.stack([0.3 + 0.6 * across, 0.2 + 0.12 * along], -1)
            pairs.append(lying if part else upright)
        low = np.arange(len(some) - 1) + start
        high = low + len(some)
        faces += [np.stack([low, low + 1, high + 1], -1), np.stack([low, high + 1, high], -1)]
    return make_mesh(
        np.concatenate(places),
        np.concatenate(faces),
        normals=np.concatenate(normals),
        uv=np.concatenate(pairs),
        name="column",
    )
