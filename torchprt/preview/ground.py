"""A ground in a picture: it is not framed, and it fades, because its edge is no part of the scene."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from torchprt.transfer import Receivers

REACH = 8.0
"""Radius of a ground, in radii of what stands on it (`Scene.on_ground`)."""
NEAR = 1.2
"""How far it is whole, in the same unit."""
CAMERA = 3.3
"""Where a camera usually stands."""
POWER = 1.6
"""Above 1, because half of the light is much more than half as bright to the eye."""


def subject(receivers: Receivers) -> Float[Tensor, "S 3"]:
    """What a camera is to hold in its picture: the places of all but the ground, unless there is nothing else."""
    return receivers.subject


def opacity(receivers: Receivers) -> Float[Tensor, "P"] | None:
    """How much of every vertex of their surface covers what is behind it: 1 on the model, on a ground down to 0 at its
    edge.

    It falls evenly in the picture of a low camera, in which what is n times as far is n times nearer to the horizon.
    None where there is no ground, or nothing else.
    """
    ground, positions = receivers.surface_ground(), receivers.surface[0]
    if not bool(ground.any()) or bool(ground.all()):
        return None
    places = positions[ground].double()
    middle = (places.amin(0) + places.amax(0)) / 2
    away = (places - middle).norm(dim=-1)
    away = REACH * away / away.amax().clamp(min=1e-30)
    ends = 1 / (NEAR + CAMERA), 1 / (REACH + CAMERA)
    left = ((1 / (away + CAMERA) - ends[1]) / (ends[0] - ends[1])).clamp(0, 1)
    seen = positions.new_ones(len(positions))
    # Starts and ends without a kink: neither is seen as a line.
    seen[ground] = (left * left * (3 - 2 * left)).pow(POWER).to(seen.dtype)
    return seen
