"""From the eye to the directions in which receivers send light, in operators that every web runtime has."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

Eye = Literal["point", "direction"]

# Of both, squares and lengths: what `shade.eye.local_views` takes for nothing in float32.
NOTHING = torch.finfo(torch.float32).tiny ** 0.5


class EyeGraph(nn.Module):
    """Local directions `[3, B, G]` toward `eye [B, 3]`: a point of the scene, or a direction away from the surfaces.

    What `shade.eye.local_views` computes, below the horizon and at the receiver too, without ReduceMax, which
    `ALLOWED` leaves out. Receivers are last, as everywhere in a graph.
    """

    frames: Tensor
    positions: Tensor | None

    def __init__(self, frames: Tensor, positions: Tensor | None) -> None:
        """`frames [3, 3, G]`, rows tangent, bitangent, normal; `positions [3, G]`, or None for directions."""
        super().__init__()
        self.register_buffer("frames", frames.float().contiguous())
        self.register_buffer("positions", None if positions is None else positions.float().contiguous())

    def forward(self, eye: Tensor) -> Tensor:
        if self.positions is None:
            # A direction of any length is one; a point this near is none.
            x, y, z = (scaled(eye, -1, 0.0).unsqueeze(0) @ self.frames).unbind(0)
        else:
            away = scaled(eye.unsqueeze(-1) - self.positions, 1, NOTHING)
            x, y, z = ((away * axis).sum(1) for axis in self.frames.unbind(0))
        return above_horizon(x, y, z)


def above_horizon(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Unit directions `[3, ...]`, moved to the horizon where they are below it; the pole where there is none."""
    z = z.clamp(min=0)
    squared = x * x + y * y + z * z
    found = squared > NOTHING
    length = torch.sqrt(torch.where(found, squared, 1.0))
    x, y, z = (torch.where(found, axis / length, pole) for axis, pole in ((x, 0.0), (y, 0.0), (z, 1.0)))
    return torch.stack([x, y, z])


def scaled(direction: Tensor, dimension: int, nothing: float) -> Tensor:
    """Divided by the largest component, as squares of the very long and the very short leave the range; or zero."""
    x, y, z = direction.abs().split(1, dimension)
    largest = torch.maximum(torch.maximum(x, y), z)
    return direction / torch.where(largest > nothing, largest, torch.inf)
