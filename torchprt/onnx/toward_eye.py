"""From the eye to the directions in which receivers send light, in operators that every web runtime has."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

Eye = Literal["point", "direction"]

# Of both, squares and lengths: what `shade.view_directions` takes for nothing in float32.
NOTHING = torch.finfo(torch.float32).tiny ** 0.5


class TowardEye(nn.Module):
    """Local directions `[3, B, G]` toward `eye [B, 3]`: a point of the scene, or a direction away from the surfaces.

    What `shade.view_directions.local_views` computes, below the horizon and at the receiver too, without ReduceMax,
    which `ALLOWED` leaves out. Receivers are last, as everywhere in a graph. In a pose: from `points [3, G]`, with
    frames of the pose `turned [3, 3, G]`.
    """

    frames: Tensor
    positions: Tensor | None

    def __init__(self, frames: Tensor, positions: Tensor | None, eye: Eye) -> None:
        """`frames [3, 3, G]`, rows tangent, bitangent, normal; `positions [3, G]`, unless a pose says them."""
        super().__init__()
        self.point = eye == "point"
        self.register_buffer("frames", frames.float().contiguous())
        stay = positions is not None and self.point
        self.register_buffer("positions", positions.float().contiguous() if stay and positions is not None else None)

    def forward(self, eye: Tensor, turned: Tensor | None = None, points: Tensor | None = None) -> Tensor:
        if not self.point:
            # A direction of any length is one; a point this near is none.
            away = scaled(eye, -1, 0.0)
            if turned is None:
                return above_horizon(*(away.unsqueeze(0) @ self.frames).unbind(0))
            away = away.unsqueeze(-1)
        else:
            places = self.positions if points is None else points
            assert places is not None
            away = scaled(eye.unsqueeze(-1) - places, 1, NOTHING)
        if turned is not None:
            # The transpose turns back into the rest pose.
            away = (turned * away.unsqueeze(2)).sum(1)
        return above_horizon(*((away * axis).sum(1) for axis in self.frames.unbind(0)))


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
