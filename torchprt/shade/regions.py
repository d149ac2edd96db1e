"""Regions of a mesh: who neighbours whom, and how much of a level a receiver gets, from light to light."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.shade.batches import receivers_of


class Neighbours:
    """The receivers that share an edge with each of G receivers, one list after the other.

    `faces [F, 3]` name receivers of a mesh; with `among`, [G] of its vertices in ascending order, those that are not
    among them are left out, and receivers are numbered as they stand there. `count`: how many vertices there are.
    Raises InputError if faces are not triangles of those vertices.
    """

    def __init__(self, faces: Tensor, count: int, among: Tensor | None = None):
        check_faces(faces, count)
        corners = faces.long()
        if among is not None:
            place = corners.new_full((count,), -1)
            place[among] = torch.arange(len(among), device=among.device)
            corners, count = place[corners], len(among)
        first = torch.cat([corners, corners.roll(1, -1)]).reshape(-1)
        second = torch.cat([corners.roll(1, -1), corners]).reshape(-1)
        kept = (first >= 0) & (second >= 0) & (first != second)
        pairs = torch.unique(first[kept] * max(count, 1) + second[kept])
        owner = pairs // max(count, 1)
        self.other = pairs - owner * max(count, 1)
        self.degree = torch.bincount(owner, minlength=count)
        self.start = self.degree.cumsum(0) - self.degree
        self.count = count

    def of(self, receivers: Int[Tensor, "g"]) -> tuple[Int[Tensor, "e"], Int[Tensor, "e"]]:
        """All neighbours of `receivers`, and at which place in that list the one stands whose neighbour each is."""
        degree = self.degree[receivers]
        total = int(degree.sum())
        owner = torch.arange(len(receivers), device=receivers.device).repeat_interleave(degree, output_size=total)
        skipped = self.start[receivers] - (degree.cumsum(0) - degree)
        place = torch.arange(total, device=receivers.device) + skipped[owner]
        return self.other[place], owner

    def beside(self, inside: Bool[Tensor, "G"]) -> Bool[Tensor, "G"]:
        """Which receivers have a neighbour that is `inside`."""
        found = torch.zeros_like(inside)
        found[self.of(inside.nonzero()[:, 0])[0]] = True
        return found

    def around(self, receivers: Int[Tensor, "g"], among: Bool[Tensor, "G"]) -> Int[Tensor, "h"]:
        """Those neighbours of `receivers` that are `among` others, each once, ascending."""
        found = torch.zeros_like(among)
        found[self.of(receivers)[0]] = True
        return (found & among).nonzero()[:, 0]

    def mean(self, values: Float[Tensor, "*B G"], receivers: Int[Tensor, "g"]) -> Float[Tensor, "*B g"]:
        """For each of `receivers` the mean of `values` over its neighbours; 0 without any."""
        other, owner = self.of(receivers)
        total = values.new_zeros(*values.shape[:-1], len(receivers)).index_add(-1, owner, receivers_of(values, other))
        return total / self.degree[receivers].clamp(min=1)

    def largest(self, values: Float[Tensor, "*B G"], receivers: Int[Tensor, "g"]) -> Float[Tensor, "*B g"]:
        """For each of `receivers` the largest of `values` of its neighbours, which are zero or more; 0 without any."""
        other, owner = self.of(receivers)
        at = owner.expand(*values.shape[:-1], len(other))
        below = values.new_zeros(*values.shape[:-1], len(receivers))
        return below.scatter_reduce(-1, at, receivers_of(values, other), "amax")


def check_faces(faces: Tensor, count: int) -> None:
    """InputError unless they are triangles of `count` vertices."""
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"faces have shape {list(faces.shape)}: give triangles, [F, 3]")
    if faces.numel() and (int(faces.min()) < 0 or int(faces.max()) >= count):
        raise InputError(f"faces name vertices outside 0 to {count - 1}: give those of the transfer of the shader")


@dataclass(frozen=True)
class Gate:
    """How much of a level a receiver gets, by the difference that the level before made: 0, 1, or between.

    A receiver enters as the difference rises from 1 - `blend` to 1 + `blend` times `enter`, smoothly, and leaves as it
    falls over the same span about `leave`, at most `enter`. In between it stays as it was: a play operator, continuous
    in the difference, which never swings to and fro about one threshold.
    """

    enter: float
    leave: float
    blend: float

    def __call__(
        self, difference: Float[Tensor, "*B G"], white: Float[Tensor, "*B 1"], before: Float[Tensor, "*B G"] | None
    ) -> Float[Tensor, "*B G"]:
        """Weights in [0, 1]. Thresholds are multiples of `white`; `before`: the weights of the last frame."""
        entering = self._step(difference, self.enter * white)
        if before is None:
            return entering
        return torch.maximum(entering, torch.minimum(before, self._step(difference, self.leave * white)))

    def _step(self, difference: Tensor, threshold: Tensor) -> Tensor:
        low, high = threshold * (1 - self.blend), threshold * (1 + self.blend)
        span = high - low
        # Where there is no span, and everything is in at threshold zero.
        whole = (difference >= high).to(difference.dtype)
        ramp = ((difference - low) / torch.where(span > 0, span, 1.0)).clamp(0, 1)
        return torch.where(span > 0, ramp * ramp * (3 - 2 * ramp), whole)
