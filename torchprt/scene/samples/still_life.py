"""A few things on a ground: shadows that meet, and colours that light carries from one to the other."""

from dataclasses import replace

import torch

from torchprt.errors import InputError

from ..material import Material
from ..mesh import make_mesh
from ..object import Object
from ..scene import Scene
from .coloured_box import block, sphere
from .vase import vase

GLAZE = (0.05, 0.22, 0.45)
CLAY = (0.62, 0.2, 0.09)
PLASTER = (0.7, 0.68, 0.62)
GROUND = (0.5, 0.47, 0.43)
"""Linear RGB."""


def still_life(resolution: int = 64) -> Scene:
    """A blue vase, a ball of clay and a block of plaster, up to 2.2 units high, on a ground at y = 0.

    The vase is that of `vase`, with its texture coordinates; the others have as many squares along 2 units.

    Raises InputError if `resolution` is below 16.
    """
    if resolution < 16:
        raise InputError(f"resolution is {resolution}: give at least 16")
    pot = vase(resolution).objects[0].mesh
    pot = replace(pot, positions=pot.positions + torch.tensor([-0.25, 0.0, -0.35], dtype=torch.float64))
    ball = make_mesh(*sphere((0.75, 0.42, 0.55), 0.42, resolution), name="ball")
    low = make_mesh(*block((-1.25, 0.0, 0.55), (0.7, 0.7, 0.7), 28.0, resolution), name="block")
    things = [Object(pot, Material(GLAZE)), Object(ball, Material(CLAY)), Object(low, Material(PLASTER))]
    return Scene(things).on_ground(0.0, GROUND)
