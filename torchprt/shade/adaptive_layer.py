"""One layer, shaded band by band where the last bands made a difference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.shade.layer import LayerModule
from torchprt.shade.regions import Gate, Neighbours


@dataclass(frozen=True)
class Region:
    """What became of a layer of G receivers in a call: `weights`, for every level above the second how much of it each
    receiver got, `[*B, G]`, and `orders [G]`, the highest that was evaluated for it, under any light of the batch."""

    weights: tuple[Tensor, ...]
    orders: Int[Tensor, "G"]


class AdaptiveLayer:
    """A layer at rising orders of the light.

    All receivers are shaded at the first two orders. Those for which the second made a difference, and those around
    them for which the next one does, go on to the third, and so on. Differences are those of displayed radiance, the
    largest of the channels: of the order below (`against` "last"), or of the first order ("base", as in the paper,
    where a receiver goes on to the end although it has long settled).

    `rings`: how many rings around the region get the mean difference of their neighbours. `grow`: whether a level grows
    into what surrounds it. Both need `neighbours`.
    """

    def __init__(
        self,
        layer: LayerModule,
        orders: Sequence[int],
        gate: Gate,
        neighbours: Neighbours | None,
        *,
        against: str,
        rings: int,
        grow: bool,
    ):
        self.layer, self.gate, self.neighbours = layer, gate, neighbours
        self.levels = layer.levels(orders)
        self.orders = self.levels.orders
        self.against, self.rings, self.grow = against, rings, grow

    @torch.no_grad()
    def cost(self, region: Region) -> float:
        """Multiplications of a call that left `region`, relative to those of all receivers at the last order."""
        counts = [int((region.orders >= order).sum()) for order in self.orders]
        steps = [self.levels.multiplications(level, level - 1 if level else None) for level in range(len(counts))]
        whole = len(region.orders) * self.levels.multiplications(len(counts) - 1, None)
        return sum(count * step for count, step in zip(counts, steps, strict=True)) / max(whole, 1)

    def base(self, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Float[Tensor, "... 3 G"]:
        """Radiance at the first order, without the weight."""
        return self.levels.at(0, light, values, frames, None, None)

    def __call__(
        self,
        light: Float[Tensor, "*#B N 3"],
        values: Tensor | None,
        frames: Tensor | None,
        white: Float[Tensor, "*#B"],
        before: Region | None,
    ) -> tuple[Float[Tensor, "... 3 G"], Region]:
        """Radiance, weight included, and what became of the region; `before`: that of the last frame."""
        first = self.base(light, values, frames)
        reached = torch.full((first.shape[-1],), self.orders[0], device=first.device)
        if len(self.orders) == 1 or math.isinf(self.gate.enter):
            return first * self.layer.weight.T, Region((), reached)
        # Everything stands at this order.
        second = self.levels.at(1, light, values, frames, None, (0, first))
        reached.fill_(self.orders[1])
        threshold = white.unsqueeze(-1)
        total, radiance, difference = second, second, self._difference(second, first, None)
        weights: list[Tensor] = []
        within: Tensor | None = None
        for level in range(2, len(self.orders)):
            last = None if before is None else before.weights[level - 2]
            weight = self.gate(difference, threshold, last)
            weight = weight if within is None else weight * within
            chosen = _any(weight > 0).nonzero()[:, 0]
            if not len(chosen):
                weights += [torch.zeros_like(weight)] * (len(self.orders) - level)
                break
            below = radiance[..., chosen]
            found = self.levels.at(level, light, values, frames, chosen, (level - 1, below))
            beside = below if self.against == "last" else first[..., chosen]
            difference = torch.zeros_like(weight).index_copy(-1, chosen, self._difference(found, beside, chosen))
            radiance = radiance.index_copy(-1, chosen, found)
            reached[chosen] = self.orders[level]
            if self.grow and self.neighbours is not None:
                outside = torch.ones(len(reached), dtype=torch.bool, device=reached.device)
                outside[chosen] = False
                changing = weight * self.gate(difference, threshold, None)
                edge = chosen[_any(changing > 0)[chosen]]
                while len(edge := self.neighbours.around(edge, outside)):
                    outside[edge] = False
                    found = self.levels.at(level, light, values, frames, edge, (1, second[..., edge]))
                    beside = radiance[..., edge] if self.against == "last" else first[..., edge]
                    made = self._difference(found, beside, edge)
                    strength = self.gate(made, threshold, None if last is None else last[..., edge])
                    strength = strength * self.neighbours.largest(changing, edge)
                    going_on = strength * self.gate(made, threshold, None)
                    weight, changing = (
                        whole.index_copy(-1, edge, part)
                        for whole, part in ((weight, strength), (changing, going_on))
                    )
                    difference = difference.index_copy(-1, edge, made)
                    radiance = radiance.index_copy(-1, edge, found)
                    reached[edge] = self.orders[level]
                    edge = edge[_any(going_on > 0)]
            total = torch.lerp(total, radiance, weight.unsqueeze(-2))
            weights.append(weight)
            within = weight
        region = Region(tuple(each.detach() for each in weights), reached)
        if self.rings and weights and self.neighbours is not None:
            total = second + self._surrounded(total - second, weights[0] > 0)
        return total * self.layer.weight.T, region

    def _difference(self, one: Tensor, other: Tensor, receivers: Tensor | None) -> Float[Tensor, "*B g"]:
        weight = self.layer.weight
        if receivers is not None and len(weight) > 1:
            weight = weight[receivers]
        return ((one - other) * weight.T).abs().amax(-2)

    def _surrounded(self, added: Float[Tensor, "*B 3 G"], inside: Tensor) -> Float[Tensor, "*B 3 G"]:
        """What the region `inside`, of each light, adds, with rings around it of what its neighbours add."""
        assert self.neighbours is not None
        for _ in range(self.rings):
            edge = self.neighbours.around(_any(inside).nonzero()[:, 0], ~_all(inside))
            if not len(edge):
                break
            new = (self.neighbours.largest(inside.to(added.dtype), edge) > 0) & ~inside[..., edge]
            spread = self.neighbours.mean(added, edge) * new.unsqueeze(-2)
            added = added.index_add(-1, edge, spread)
            inside = inside.index_copy(-1, edge, inside[..., edge] | new)
        return added


def _any(inside: Tensor) -> Tensor:
    """Of `[*B, G]` whether any light says so, `[G]`."""
    return inside.reshape(-1, inside.shape[-1]).any(0)


def _all(inside: Tensor) -> Tensor:
    return inside.reshape(-1, inside.shape[-1]).all(0)
