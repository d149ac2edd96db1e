"""Sums over the neighbours of each vertex by gathers alone: a scatter is a loop in some runtimes."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

# As wide as the vertex with the most entries, but no wider than this: most have six, and one fan may have thousands.
WIDEST = 8


class SumRows(nn.Module):
    """Sums `[..., W, R]`, row by row, and then the rows of each of V vertices, to `[..., V]`.

    Rows are last, so that a sum adds long streams.
    """

    def __init__(self, width: int, more: list[Tensor]) -> None:
        """`more`: for each further level the slots `[W, R]` of rows that are summed, the last row being a zero."""
        super().__init__()
        self.width = width
        self.levels = len(more)
        for level, rows in enumerate(more):
            self.register_buffer(f"rows{level}", rows, persistent=False)

    def forward(self, values: Float[Tensor, "*B W R"]) -> Float[Tensor, "*B V"]:
        sums = values.sum(-2)
        for level in range(self.levels):
            rows = getattr(self, f"rows{level}")
            padded = torch.cat([sums, torch.zeros_like(sums[..., :1])], -1)
            sums = pick(padded, rows.reshape(-1)).unflatten(-1, rows.shape).sum(-2)
        return sums


def pick(vectors: Tensor, index: Tensor) -> Tensor:
    """Of `vectors [3, ..., V]` those that `index [E]` names."""
    if torch.compiler.is_compiling():
        # Gather of ONNX Runtime copies one stretch of memory after the other: three numbers at a time, not one.
        return vectors.movedim(0, -1).index_select(-2, index).movedim(-1, 0).contiguous()
    return vectors.index_select(-1, index)


def rows_of(owner: Int[Tensor, " E"], count: int) -> tuple[Int[Tensor, "W R"], Int[Tensor, " R"], SumRows]:
    """Slots for E entries of `count` vertices, `owner` ascending; whose the rows are; and the module that sums them.

    Slots hold the number of an entry, or E where they stay empty; a vertex has one row or more.
    """
    widest = int(torch.bincount(owner, minlength=1).max())
    width = min(max(widest, 1), WIDEST)
    slots, own = _level(owner, count, width)
    belongs, more = own, []
    while len(belongs) > count:
        # Few vertices have more than one row, so rows of rows are narrow.
        widest = int(torch.bincount(belongs).max())
        rows, belongs = _level(belongs, count, min(widest, WIDEST))
        more.append(rows.int())
    return slots, own, SumRows(width, more)


def _level(owner: Tensor, count: int, width: int) -> tuple[Tensor, Tensor]:
    """Slots of the rows, and whom each row belongs to."""
    many = torch.bincount(owner, minlength=count)
    first = many.cumsum(0) - many
    rows = (many + width - 1).div(width, rounding_mode="floor").clamp(min=1)
    belongs = torch.arange(count, device=owner.device).repeat_interleave(rows)
    place = torch.arange(len(belongs), device=owner.device) - (rows.cumsum(0) - rows)[belongs]
    slots = first[belongs, None] + place[:, None] * width + torch.arange(width, device=owner.device)
    slots = torch.where(slots < (first + many)[belongs, None], slots, len(owner))
    return slots.T.contiguous(), belongs
