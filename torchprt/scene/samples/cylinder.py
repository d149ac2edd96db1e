"""An upright cylinder with texture coordinates, to lay patches on, to bend and to twist."""

import numpy as np

from torchprt.errors import InputError

from ..material import Albedo, Material
from ..mesh import make_mesh
from ..object import Object
from ..scene import Scene
from .grid import grid

RADIUS, HEIGHT = 0.5, 3.0


def cylinder(resolution: int = 64, albedo: Albedo = 0.6) -> Scene:
    """The wall of a cylinder of radius .5 and height 3 about +y, standing on y = 0, without lids.

    2 `resolution` columns around and as many rows of squares. Texture coordinates: u around (counter-clockwise seen
    from above), v up, both from 0 to 1.

    Raises InputError if `resolution` is below 4.
    """
    if resolution < 4:
        raise InputError(f"resolution is {resolution}: give at least 4")
    n = 2 * resolution
    flat, faces = grid((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), n, n)
    uv = flat[faces][..., :2]
    # The last column is the first.
    row, column = np.divmod(np.arange(len(flat)), n + 1)
    first = column < n
    angle = 2 * np.pi * flat[first, 0]
    out = np.stack([np.cos(angle), np.zeros_like(angle), -np.sin(angle)], axis=1)
    positions = RADIUS * out + HEIGHT * flat[first, 1:2] * np.array([0.0, 1.0, 0.0])
    faces = (row * n + column % n)[faces]
    return Scene([Object(make_mesh(positions, faces, normals=out, name="cylinder", uv=uv), Material(albedo))])
