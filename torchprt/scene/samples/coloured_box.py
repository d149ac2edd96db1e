"""A room with a red and a green wall: light that bounces carries colour."""

import numpy as np
from jaxtyping import Float, Int

from torchprt.errors import InputError

from ..material import Material
from ..mesh import make_mesh
from ..object import Object
from ..scene import Scene
from .grid import grid, join

RED = (0.63, 0.065, 0.05)
GREEN = (0.14, 0.45, 0.091)
WHITE = (0.725, 0.71, 0.68)
"""Linear RGB near the measured walls of the Cornell box."""


def coloured_box(resolution: int = 64) -> Scene:
    """A box from -1 to 1, open to the front (+z) and without a ceiling lamp, holding a tall block and a sphere.

    The wall at -x is red, the wall at +x green, all else white. Each wall has `resolution` by `resolution` squares.

    Raises InputError if `resolution` is below 4.
    Source: Goral et al. 1984, "Modeling the interaction of light between diffuse surfaces".
    """
    if resolution < 4:
        raise InputError(f"resolution is {resolution}: give at least 4")
    n = resolution
    floor = grid((-1.0, -1.0, 1.0), (2.0, 0.0, 0.0), (0.0, 0.0, -2.0), n, n)
    ceiling = grid((-1.0, 1.0, -1.0), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0), n, n)
    back = grid((-1.0, -1.0, -1.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0), n, n)
    left = grid((-1.0, -1.0, 1.0), (0.0, 0.0, -2.0), (0.0, 2.0, 0.0), n, n)
    right = grid((1.0, -1.0, -1.0), (0.0, 0.0, 2.0), (0.0, 2.0, 0.0), n, n)
    ball = sphere((0.42, -0.62, 0.3), 0.38, n)
    tall = block((-0.38, -1.0, -0.32), (0.6, 1.25, 0.6), 17.0, n)
    return Scene(
        [
            Object(make_mesh(*join(floor, ceiling, back), name="room"), Material(WHITE)),
            Object(make_mesh(*left, name="red wall"), Material(RED)),
            Object(make_mesh(*right, name="green wall"), Material(GREEN)),
            Object(make_mesh(*tall, name="block"), Material(WHITE)),
            Object(make_mesh(*ball, name="sphere"), Material(WHITE)),
        ]
    )


def sphere(
    centre: tuple[float, float, float], radius: float, resolution: int
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """A ball whose triangles are about as large as those of walls with `resolution` squares along 2 units."""
    from trimesh.creation import icosphere

    subdivisions = max(1, round(np.log2(resolution * radius / 1.2)))
    ball = icosphere(subdivisions=subdivisions, radius=radius)
    return ball.vertices + np.array(centre), ball.faces.astype(np.int64)


def block(
    foot: tuple[float, float, float], size: tuple[float, float, float], degrees: float, resolution: int
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """A block without a bottom, its foot centred at `foot`, turned about +y."""
    x, y, z = size
    n = max(2, round(resolution * x / 2))
    m = max(2, round(resolution * y / 2))
    sides = [
        grid((-x / 2, 0.0, z / 2), (x, 0.0, 0.0), (0.0, y, 0.0), n, m),
        grid((x / 2, 0.0, z / 2), (0.0, 0.0, -z), (0.0, y, 0.0), n, m),
        grid((x / 2, 0.0, -z / 2), (-x, 0.0, 0.0), (0.0, y, 0.0), n, m),
        grid((-x / 2, 0.0, -z / 2), (0.0, 0.0, z), (0.0, y, 0.0), n, m),
        grid((-x / 2, y, z / 2), (x, 0.0, 0.0), (0.0, 0.0, -z), n, n),
    ]
    positions, faces = join(*sides)
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return positions @ turn.T + np.array(foot), faces
