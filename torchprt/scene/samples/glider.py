"""A hang glider, and bumpy land for it to fly over."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.errors import InputError

from ..material import Material
from ..mesh import make_mesh
from ..object import Object
from ..scene import Scene
from .grid import grid, join

SAIL = (0.75, 0.16, 0.05)
"""Albedo of the sail; that of pilot and frame is `DARK`."""
DARK = 0.12
LENGTH = 0.36
"""Of the pilot, who lies below the sail."""
RELIEF = 0.22
"""Of the land, in units of the glider, whose span is 2."""

_Sheet = tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]


def glider(resolution: int = 48) -> Scene:
    """A hang glider with its pilot, 2 wide along x, its nose toward +z, the middle of its sail at the origin.

    The sail is a sheet of 2 `resolution` by `resolution` / 2 squares that reflects on both sides; pilot and frame are
    closed. Raises InputError if `resolution` is below 8.
    Source: the subject of Sloan, Kautz and Snyder 2002, figure 7; the shape is the project's own.
    """
    if resolution < 8:
        raise InputError(f"resolution is {resolution}: give at least 8")
    sides = max(resolution // 4, 6)
    left, right, top = (np.array(corner) for corner in ((-0.3, -0.42, 0.12), (0.3, -0.42, 0.12), (0.0, 0.02, 0.06)))
    tubes = [_tube(left, right, sides), _tube(left, top, sides), _tube(right, top, sides)]
    tubes.append(_tube(np.array([0.0, 0.03, -0.42]), np.array([0.0, 0.03, 0.6]), sides))
    body = _ellipsoid(np.array([0.0, -0.3, -0.12]), np.array([0.085, 0.075, LENGTH]), resolution)
    head = _ellipsoid(np.array([0.0, -0.27, 0.27]), np.array([0.07, 0.07, 0.07]), resolution // 2)
    return Scene(
        [
            Object(make_mesh(*_sail(resolution), name="sail"), Material(SAIL, two_sided=True)),
            Object(make_mesh(*join(body, head, *tubes), name="pilot and frame"), Material(DARK)),
        ]
    )


def terrain(resolution: int = 160, extent: float = 8.0, albedo: float = 0.6, seed: int = 4) -> Scene:
    """Land of round bumps, `extent` wide along x and z around the origin, its mean height at y = 0, facing +y.

    `resolution` squares a side; another `seed` is other land. Raises InputError if `resolution` is below 2 or `extent`
    is not above 0.
    """
    if resolution < 2 or not 0 < extent < np.inf:
        raise InputError(f"resolution is {resolution} and extent {extent:g}: give at least 2, and a size above 0")
    half = extent / 2
    positions, faces = grid((-half, 0.0, half), (extent, 0.0, 0.0), (0.0, 0.0, -extent), resolution, resolution)
    positions[:, 1] = land(torch.from_numpy(positions[:, [0, 2]]), seed).numpy()
    return Scene([Object(make_mesh(positions, faces, name="terrain"), Material(albedo))])


def land(places: Float[Tensor, "*P 2"], seed: int = 4) -> Float[Tensor, "*P"]:
    """The height of the `terrain` of that seed at x, z: waves of many directions, shorter ones lower."""
    generator = np.random.default_rng(seed)
    height = torch.zeros_like(places[..., 0])
    for length, count in ((4.2, 3), (2.1, 4), (1.1, 5)):
        for angle, phase in zip(*(generator.uniform(0, 2 * np.pi, count) for _ in range(2)), strict=True):
            along = places[..., 0] * np.cos(angle) + places[..., 1] * np.sin(angle)
            height = height + length / 4.2 / count**0.5 * torch.sin(2 * np.pi * along / length + phase)
    return RELIEF * height


def _sail(resolution: int) -> _Sheet:
    """A delta between a leading edge that is swept back and a trailing edge that is drawn in, with billow."""
    flat, faces = grid((-1.0, 0.0, 1.0), (2.0, 0.0, 0.0), (0.0, 0.0, -1.0), 2 * resolution, max(resolution // 2, 4))
    side, chord = flat[:, 0], flat[:, 2]
    span = np.abs(side)
    front = 0.55 - 0.78 * span
    rear = -0.26 - 0.16 * span + 0.1 * np.sin(np.pi * span) + 0.012 * np.cos(10 * np.pi * span)
    z = rear + (front - rear) * chord
    billow = 0.09 * np.sin(np.pi * span) * np.sin(np.pi * (0.15 + 0.85 * (1 - chord)))
    return np.stack([side, 0.05 * span + billow, z], -1), faces


def _ellipsoid(middle: np.ndarray, radii: np.ndarray, around: int) -> _Sheet:
    rings = max(around // 2, 4)
    flat, faces = grid((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), around, rings)
    turn, rise = 2 * np.pi * flat[:, 0], np.pi * flat[:, 1]
    points = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), -np.cos(rise)], -1)
    return middle + points * radii, faces


def _tube(start: np.ndarray, end: np.ndarray, sides: int, radius: float = 0.014) -> _Sheet:
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.linalg.svd(axis[None])[2][1:]
    # A frame whose turn about the axis is right-handed, so that faces look outward.
    if np.linalg.det(np.stack([*across, axis])) < 0:
        across = across[::-1]
    flat, faces = grid((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), sides, 3)
    turn, step = 2 * np.pi * flat[:, 0], np.round(3 * flat[:, 1]).astype(int)
    # Two caps of no radius, and the wall between.
    wide = np.where((step == 1) | (step == 2), radius, 0.0)[:, None]
    place = start + np.where(step < 2, 0.0, 1.0)[:, None] * (end - start)
    return place + wide * (np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]), faces
