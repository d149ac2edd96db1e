"""A furnished room with a window, of large flat faces: what a lightmap is for."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from torchprt.errors import InputError

from ..material import Material
from ..mesh import Mesh, make_mesh
from ..object import Object
from ..scene import Scene
from .grid import grid

Number = float | int
Vector = tuple[Number, Number, Number]
HALF, DEPTH, HEIGHT = 2.3, 2.9, 2.7
"""Half the width and half the depth of the room, and its height, in metres."""
WALL = 0.22
WINDOW = (-1.7, 1.1, 0.75, 2.35)
"""From where to where the window reaches along z, and up."""

PLASTER, TEAL, OAK, WHITE = (0.76, 0.74, 0.70), (0.10, 0.30, 0.33), (0.46, 0.27, 0.13), (0.80, 0.80, 0.78)
WOOL, LINEN, MUSTARD, CLAY, BLACK = (
    (0.58, 0.15, 0.09),
    (0.60, 0.57, 0.50),
    (0.66, 0.40, 0.06),
    (0.55, 0.24, 0.13),
    (0.05,) * 3,
)
BOOKS = (
    (0.42, 0.09, 0.07),
    (0.08, 0.18, 0.34),
    (0.62, 0.52, 0.34),
    (0.11, 0.26, 0.15),
    (0.70, 0.66, 0.58),
    (0.50, 0.28, 0.07),
)


@dataclass(frozen=True)
class Sheet:
    """A flat or bent sheet that is one chart: places and faces, texture coordinates in metres, and its size in them."""

    positions: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    places: Float[np.ndarray, "v 2"]
    normals: Float[np.ndarray, "v 3"] | None = None

    @property
    def size(self) -> Float[np.ndarray, "2"]:
        found: np.ndarray = self.places.max(0)
        return found


def room(texels: int = 512, gutter: int = 2) -> Scene:
    """A living room, 4.6 x 5.8 x 2.7 m, y up, with a window in the wall at -x; texture coordinates of all of it lie on
    one square map without overlap.

    Walls, floor and most furniture have two triangles a side. Charts keep `gutter` texels free on each side of
    them on a map of `texels` x `texels`, and all have the same scale.
    Raises InputError if `texels` is below 128 or `gutter` below 0.
    """
    if texels < 128 or gutter < 0:
        raise InputError(f"a room on a map of {texels} texels, {gutter} between charts: give at least 128, and 0")
    parts = {name: (list(sheets), albedo) for name, sheets, albedo in _parts()}
    every = [sheet for sheets, _ in parts.values() for sheet in sheets]
    corners, scale = _packed([sheet.size for sheet in every], texels, gutter)
    placed = iter(zip(every, corners, strict=True))
    objects = []
    for name, (sheets, albedo) in parts.items():
        mine = [next(placed) for _ in sheets]
        objects.append(Object(_mesh(name, mine, scale, texels), Material(albedo)))
    return Scene(objects)


def _mesh(name: str, sheets: Sequence[tuple[Sheet, np.ndarray]], scale: float, texels: int) -> Mesh:
    starts = np.cumsum([0] + [len(sheet.positions) for sheet, _ in sheets])
    uv = [(corner + sheet.places / sheet.size * np.ceil(sheet.size * scale)) / texels for sheet, corner in sheets]
    normals = [np.zeros_like(sheet.positions) if sheet.normals is None else sheet.normals for sheet, _ in sheets]
    return make_mesh(
        np.concatenate([sheet.positions for sheet, _ in sheets]),
        np.concatenate([sheet.faces + start for (sheet, _), start in zip(sheets, starts, strict=False)]),
        normals=np.concatenate(normals),
        uv=np.concatenate(uv),
        name=name,
    )


def _packed(sizes: Sequence[np.ndarray], texels: int, gutter: int) -> tuple[list[np.ndarray], float]:
    """Where the upper left corners of charts lie on the map, in texels, and how many texels a metre has: as many as
    fit."""
    low, high = 0.0, float(texels)
    while high - low > 1e-3 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if _shelves(sizes, middle, texels, gutter) else (low, middle)
    found = _shelves(sizes, low, texels, gutter)
    assert found is not None
    return found, low


def _shelves(sizes: Sequence[np.ndarray], scale: float, texels: int, gutter: int) -> list[np.ndarray] | None:
    """Charts in rows, the highest first; None if they do not fit."""
    whole = [np.ceil(size * scale) + 2 * gutter for size in sizes]
    corners = [np.zeros(2)] * len(sizes)
    x = y = below = 0.0
    for number in sorted(range(len(sizes)), key=lambda each: (-whole[each][1], -whole[each][0])):
        width, height = whole[number]
        if x + width > texels:
            x, y = 0.0, below
        if width > texels or y + height > texels:
            return None
        corners[number] = np.array([x + gutter, y + gutter])
        x, below = x + width, max(below, y + height)
    return corners


def _quad(origin: Vector, along: Vector, across: Vector) -> Sheet:
    """A rectangle that faces along x across."""
    start, first, second = ((float(x), float(y), float(z)) for x, y, z in (origin, along, across))
    positions, faces = grid(start, first, second, 1, 1)
    wide, high = math.hypot(*along), math.hypot(*across)
    return Sheet(positions, faces, np.array([[0, 0], [wide, 0], [0, high], [wide, high]]))


def _box(low: Vector, high: Vector, without: str = "") -> Iterator[Sheet]:
    """The outsides of a box but for those named: "x", "y", "z" for the lower, "X", "Y", "Z" for the upper."""
    (a, b, c), (x, y, z) = low, high
    w, h, d = x - a, y - b, z - c
    sides = {
        "x": ((a, b, c), (0, 0, d), (0, h, 0)),
        "X": ((x, b, z), (0, 0, -d), (0, h, 0)),
        "y": ((a, b, c), (w, 0, 0), (0, 0, d)),
        "Y": ((a, y, z), (w, 0, 0), (0, 0, -d)),
        "z": ((x, b, c), (-w, 0, 0), (0, h, 0)),
        "Z": ((a, b, z), (w, 0, 0), (0, h, 0)),
    }
    return (_quad(*side) for name, side in sides.items() if name not in without)


def _turned(profile: Sequence[tuple[Number, Number]], foot: Vector, around: int = 32) -> Sheet:
    """A surface of revolution about +y through `foot`, of radii and heights from its foot to its rim."""
    points = np.array(profile)
    lengths = np.concatenate([[0], np.hypot(*np.diff(points, axis=0).T).cumsum()])
    angles = np.linspace(0, 2 * np.pi, around + 1)
    unit = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], -1)
    positions = points[:, None, :1] * unit + points[:, None, 1:] * [0, 1, 0] + foot
    slope = np.gradient(points, axis=0)
    normals = slope[:, None, 1:] * unit - slope[:, None, :1] * [0, 1, 0]
    corner = np.arange(len(points) - 1)[:, None] * (around + 1) + np.arange(around)
    a, b, c, d = corner, corner + 1, corner + around + 2, corner + around + 1
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)], 2).reshape(-1, 3)
    across = angles * points[:, 0].max()
    places = np.stack(np.broadcast_arrays(across[None], lengths[:, None]), -1).reshape(-1, 2)
    return Sheet(positions.reshape(-1, 3), faces, places, normals.reshape(-1, 3))


def _parts() -> Iterator[tuple[str, list[Sheet], Vector]]:
    """The objects of the room: name, charts, albedo."""
    w, d, h = HALF, DEPTH, HEIGHT
    yield "floor", [_quad((-w, 0, d), (2 * w, 0, 0), (0, 0, -2 * d))], OAK
    yield "ceiling", [_quad((-w, h, -d), (2 * w, 0, 0), (0, 0, 2 * d))], PLASTER
    yield (
        "walls",
        [_quad((w, 0, d), (-2 * w, 0, 0), (0, h, 0)), _quad((w, 0, -d), (0, 0, 2 * d), (0, h, 0)), *_window_wall()],
        PLASTER,
    )
    yield "back wall", [_quad((-w, 0, -d), (2 * w, 0, 0), (0, h, 0))], TEAL
    yield "window", list(_window()), WHITE
    yield "rug", list(_box((-1.5, 0, -1.5), (1.0, 0.015, 0.9), "y")), WOOL
    yield "table", list(_table()), OAK
    yield "sofa", list(_sofa()), LINEN
    yield (
        "cushions",
        [*_box((1.5, 0.46, -1.25), (1.72, 0.86, -0.8)), *_box((1.46, 0.46, 0.3), (1.68, 0.84, 0.74))],
        MUSTARD,
    )
    yield "shelf", list(_shelf()), WHITE
    books = list(_books())
    for number, colour in enumerate(BOOKS):
        yield f"books {number}", [side for book in books[number :: len(BOOKS)] for side in _box(*book, "zy")], colour
    profile = [(0.055, 0), (0.09, 0.05), (0.115, 0.11), (0.105, 0.17), (0.065, 0.23), (0.045, 0.28), (0.055, 0.31)]
    yield "vase", [_turned(profile, (-0.25, 0.42, -0.5))], CLAY
    yield "frame", list(_box((-1.75, 1.3, -d), (-0.75, 2.0, -d + 0.035), "z")), BLACK
    yield "picture", [_quad((-1.68, 1.37, -d + 0.037), (0.86, 0, 0), (0, 0.56, 0))], WHITE


def _window_wall() -> Iterator[Sheet]:
    w, d, h = HALF, DEPTH, HEIGHT
    first, last, sill, top = WINDOW
    # The wall around the opening, and the opening's own sides.
    yield _facing_in(-d, d, 0, sill)
    yield _facing_in(-d, d, top, h)
    yield _facing_in(-d, first, sill, top)
    yield _facing_in(last, d, sill, top)
    yield _quad((-w - WALL, sill, last), (WALL, 0, 0), (0, 0, first - last))
    yield _quad((-w - WALL, top, first), (WALL, 0, 0), (0, 0, last - first))
    yield _quad((-w - WALL, sill, first), (WALL, 0, 0), (0, top - sill, 0))
    yield _quad((-w, sill, last), (-WALL, 0, 0), (0, top - sill, 0))


def _facing_in(first: Number, last: Number, low: Number, high: Number) -> Sheet:
    """A part of the wall at -x, which faces +x."""
    return _quad((-HALF, low, last), (0, 0, first - last), (0, high - low, 0))


def _window() -> Iterator[Sheet]:
    """Bars of the window."""
    first, last, sill, top = WINDOW
    out, inn = -HALF - WALL + 0.03, -HALF - WALL + 0.09
    third = (last - first) / 3
    for number in (1, 2):
        z = first + number * third
        yield from _box((out, sill, z - 0.03), (inn, top, z + 0.03), "yY")
    middle = sill + 0.7 * (top - sill)
    for number in range(3):
        low, high = first + number * third, first + (number + 1) * third
        yield from _box((out, middle - 0.025, low + 0.03), (inn, middle + 0.025, high - 0.03), "zZ")
    yield from _box((-HALF - 0.06, sill - 0.03, first - 0.08), (-HALF + 0.14, sill + 0.01, last + 0.08), "x")


def _table() -> Iterator[Sheet]:
    yield from _box((-0.85, 0.37, -0.85), (0.35, 0.42, 0.15))
    for x in (-0.8, 0.24):
        for z in (-0.8, 0.04):
            yield from _box((x, 0.015, z), (x + 0.06, 0.37, z + 0.06), "yY")


def _sofa() -> Iterator[Sheet]:
    yield from _box((1.3, 0.08, -1.2), (2.2, 0.45, 0.75), "zZ")
    yield from _box((1.95, 0.45, -1.2), (2.2, 0.95, 0.75), "y")
    yield from _box((1.25, 0.08, -1.45), (2.2, 0.65, -1.2))
    yield from _box((1.25, 0.08, 0.75), (2.2, 0.65, 1.0))


def _shelf() -> Iterator[Sheet]:
    low, high = (-0.35, 0, -DEPTH + 0.005), (1.55, 2.1, -DEPTH + 0.32)
    (x, _, z), (right, top, front) = low, high
    yield from _box((x, 0, z), (x + 0.03, top, front), "yz")
    yield from _box((right - 0.03, 0, z), (right, top, front), "yz")
    for level in range(6):
        y = level * (top - 0.03) / 5
        yield from _box((x + 0.03, y, z), (right - 0.03, y + 0.03, front), "xXz")


def _books() -> Iterator[tuple[Vector, Vector]]:
    """Rows of books on the shelves, with gaps; the same every time."""
    rng = np.random.default_rng(7)
    back = -DEPTH + 0.01
    for level in range(5):
        foot = level * 2.07 / 5 + 0.03
        x = -0.3 + rng.uniform(0.0, 0.3)
        end = 1.5 - rng.uniform(0.0, 0.7)
        while x < end:
            wide, high, deep = rng.uniform(0.04, 0.09), rng.uniform(0.24, 0.35), rng.uniform(0.18, 0.25)
            yield (x, foot, back), (x + wide, foot + high, back + deep)
            x += wide + 0.004
