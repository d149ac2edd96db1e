"""Reading a grid between its nodes."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.sh.precision import KeepsSingle, at_least_single
from torchprt.transfer import Grid


class Lattice(KeepsSingle):
    """Points to the eight nodes of a grid around them and their trilinear weights.

    Over the outermost cells the weights fall to zero: they sum to the smooth step `t^2 (3 - 2 t)` of the distance t
    from the border in cells, 1 from one cell inside, 0 on it and beyond. Plain operations, none of which a graph lacks.
    """

    single = ("origin", "step", "reach", "corners")
    origin: Tensor
    step: Tensor
    reach: Tensor
    corners: Tensor
    strides: Tensor
    numbers: Tensor

    def __init__(self, grid: Grid, dtype: torch.dtype) -> None:
        """`dtype`: of places, float32 at least."""
        super().__init__()
        wide = at_least_single(dtype)
        _, ny, nz = grid.shape
        strides = torch.tensor([ny * nz, nz, 1])
        steps = torch.tensor([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        self.register_buffer("origin", torch.tensor(grid.origin, dtype=wide))
        self.register_buffer("step", torch.tensor(grid.spacing, dtype=wide))
        self.register_buffer("reach", torch.tensor([count - 1 for count in grid.shape], dtype=wide))
        self.register_buffer("corners", steps.to(wide), persistent=False)
        self.register_buffer("strides", strides, persistent=False)
        self.register_buffer("numbers", (steps * strides).sum(-1), persistent=False)

    def forward(self, points: Float[Tensor, "*B R 3"]) -> tuple[Int[Tensor, "*B R 8"], Float[Tensor, "*B R 8"]]:
        """Points in the frame of the grid; gradients flow to them through the weights."""
        place = (points - self.origin) / self.step
        within = torch.minimum(place, self.reach - place)
        # Component by component: graphs lack the least of an axis, and cannot sum over a batch of none.
        kept = torch.minimum(torch.minimum(within[..., 0], within[..., 1]), within[..., 2]).clamp(0, 1)
        kept = kept * kept * (3 - 2 * kept)
        # Not `floor`, which graphs lack: what is not negative is cut off.
        low = torch.minimum(place.detach().clamp(min=0), self.reach - 1).long()
        part = (torch.minimum(place.clamp(min=0), self.reach) - low).unsqueeze(-2)
        sides = self.corners * part + (1 - self.corners) * (1 - part)
        weights = sides[..., 0] * sides[..., 1] * sides[..., 2] * kept.unsqueeze(-1)
        first = low[..., :1] * self.strides[0] + low[..., 1:2] * self.strides[1] + low[..., 2:]
        return first + self.numbers, weights
