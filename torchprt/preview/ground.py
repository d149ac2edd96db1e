"""A ground that a model stands on: left out where the model is framed, fading into what is behind it."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

SOLID = 0.45
"""Share of the way from the middle of the ground to its rim that is wholly opaque."""


def subject(receivers: Any) -> Float[Tensor, "S 3"]:
    """What a camera is to hold in its picture: the places of all but the ground, unless there is nothing else."""
    ground = _ground(receivers)
    if ground is None or bool(ground.all()):
        return receivers.positions
    return receivers.positions[~ground]


def opacity(receivers: Any) -> Float[Tensor, "V"] | None:
    """1 where there is a model, and on the ground falling to 0 at its rim; None if there is no ground."""
    ground = _ground(receivers)
    if ground is None:
        return None
    flat = receivers.positions[ground][:, [0, 2]].double()
    middle = (flat.amin(0) + flat.amax(0)) / 2
    far = torch.linalg.vector_norm(flat - middle, dim=-1)
    share = ((far / far.max().clamp(min=1e-300) - SOLID) / (1 - SOLID)).clamp(0, 1)
    opaque = torch.ones(len(receivers.positions))
    opaque[ground] = (1 - share * share * (3 - 2 * share)).float()
    return opaque


def _ground(receivers: Any) -> Tensor | None:
    """Which receivers are ground; None if none is."""
    ground = getattr(receivers, "ground", None)
    return ground.bool() if ground is not None and bool(ground.any()) else None
