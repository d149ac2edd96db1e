"""Deformations of vertices: what a modelling tool or a simulation would do to a mesh."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError


def bend(
    positions: Float[Tensor, "V 3"], angle: float | int | Float[Tensor, "*B"], low: float | int, high: float | int
) -> Float[Tensor, "*B V 3"]:
    """Vertices bent toward +x by `angle` radians between the heights `low` and `high`.

    The piece of the y axis between them becomes an arc of its own length; below it nothing moves, above it all moves
    rigidly. Cross sections stay as they are. Smooth in the angle, also at 0; an `angle` with dimensions gives them to
    the result; gradients flow to both.
    Raises InputError unless `low` < `high`.
    Source: Barr 1984, "Global and local deformations of solid primitives".
    """
    turn, height, rest = _along(positions, angle, low, high)
    x, _, z = positions.unbind(-1)
    sine, cosine = turn.sin(), turn.cos()
    # (1 - cos t) / t and sin t / t, which have no pole at a straight axis.
    out = height * (turn / 2).sin() * torch.sinc(turn / (2 * math.pi))
    up = height * torch.sinc(turn / math.pi)
    bent = [out + x * cosine + rest * sine, low + up - x * sine + rest * cosine, z.expand_as(out)]
    return torch.stack(bent, -1)


def twist(
    positions: Float[Tensor, "V 3"], angle: float | int | Float[Tensor, "*B"], low: float | int, high: float | int
) -> Float[Tensor, "*B V 3"]:
    """Vertices turned about +y, not at all below `low`, evenly more up to `angle` radians at `high` and above.

    An `angle` with dimensions gives them to the result; gradients flow to both.
    Raises InputError unless `low` < `high`.
    Source: Barr 1984, "Global and local deformations of solid primitives".
    """
    turn, _, _ = _along(positions, angle, low, high)
    x, y, z = positions.unbind(-1)
    sine, cosine = turn.sin(), turn.cos()
    return torch.stack([x * cosine + z * sine, y.expand_as(turn), z * cosine - x * sine], -1)


def _along(
    positions: Tensor, angle: float | int | Tensor, low: float | int, high: float | int
) -> tuple[Float[Tensor, "*B V"], Float[Tensor, "V"], Float[Tensor, "V"]]:
    """How far each vertex turns, its height within the piece that is deformed, and its height beyond it."""
    if not low < high:
        raise InputError(f"low is {low:g} and high {high:g}: give the lower height first")
    y = positions[..., 1]
    within = y.clamp(low, high)
    angles = torch.as_tensor(angle, dtype=positions.dtype, device=positions.device)
    return angles[..., None] * (within - low) / (high - low), within - low, y - within
