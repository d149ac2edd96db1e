"""A metal ring on a plane: caustics inside of it, its shadow outside."""

import numpy as np
from jaxtyping import Float, Int

from torchprt.errors import InputError

from ..material import Albedo, Material
from ..material_file import METALS
from ..mesh import Mesh, make_mesh
from ..object import Object
from ..scene import Scene
from .grid import grid

HEIGHT, THICKNESS = 0.5, 0.1
"""Of the ring, whose mean radius is 1."""
SQUARE = 6
"""Power of the superellipse that its section is: walls are straight, edges are round."""
GAP = 1e-3


def ring_on_plane(resolution: int = 256, albedo: Albedo = 0.7, metal: str = "gold", segments: int = 192) -> Scene:
    """A ring of polished metal around the y axis on a square plane, 5 wide at y = 0, of `resolution` squared receivers.

    The ring is a mirror, which records nothing: the transfer is that of the plane.
    Raises InputError if `resolution` is below 2, `segments` below 3, or the metal is not one of `METALS`.
    Source: Sloan, Kautz and Snyder 2002, section 5 and figure 9.
    """
    if resolution < 2 or segments < 3:
        raise InputError(f"resolution is {resolution} and segments {segments}: give at least 2 and 3")
    if metal not in METALS:
        raise InputError(f"metal '{metal}' is unknown: use one of {', '.join(METALS)}")
    plane = grid((-2.5, 0.0, 2.5), (5.0, 0.0, 0.0), (0.0, 0.0, -5.0), resolution - 1, resolution - 1)
    return Scene(
        [
            Object(make_mesh(*plane, name="plane"), Material(albedo)),
            Object(ring(segments), Material(mirror=METALS[metal])),
        ]
    )


def ring(segments: int = 192) -> Mesh:
    """The ring alone: a closed band of radius 1, standing on y = 0."""
    count = max(16, segments // 4)
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    cosine, sine = np.cos(angle), np.sin(angle)
    power = 2 / SQUARE
    across = THICKNESS / 2 * np.sign(cosine) * np.abs(cosine) ** power
    up = HEIGHT / 2 * np.sign(sine) * np.abs(sine) ** power
    # The gradient of |x / a|^p + |y / b|^p.
    slope = np.stack(
        [
            np.sign(across) * np.abs(2 * across / THICKNESS) ** (SQUARE - 1) / THICKNESS,
            np.sign(up) * np.abs(2 * up / HEIGHT) ** (SQUARE - 1) / HEIGHT,
        ],
        -1,
    )
    slope /= np.linalg.norm(slope, axis=-1, keepdims=True)
    positions, faces = _around(np.stack([1 + across, up + HEIGHT / 2 + GAP], -1), segments)
    normals, _ = _around(slope, segments)
    return make_mesh(positions, faces, normals=normals, name="ring")


def _around(
    section: Float[np.ndarray, "S 2"], segments: int
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """A closed section (radius, height), anticlockwise, turned about +y."""
    angle = 2 * np.pi * np.arange(segments) / segments
    around = np.stack([np.cos(angle), np.zeros(segments), -np.sin(angle)], -1)
    points = section[:, :1, None] * around[None] + section[:, 1:, None] * np.array([0.0, 1.0, 0.0])
    count = len(section)
    row, column = np.meshgrid(np.arange(count), np.arange(segments), indexing="ij")
    after, above = (column + 1) % segments, (row + 1) % count
    a, b = row * segments + column, row * segments + after
    c, d = above * segments + after, above * segments + column
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return points.reshape(-1, 3), faces
