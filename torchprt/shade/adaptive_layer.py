"""One layer, shaded band by band where the last bands made a difference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.shade.batches import receivers_of
from torchprt.shade.layer import LayerModule
from torchprt.shade.levels import Level
from torchprt.shade.regions import Gate, Neighbours

# A region stops growing where fewer receivers than this part of all gained more than this part of a level: what
# remains is not seen, and a round costs the same for few as for many.
FEWEST, LEAST = 1e-3, 1e-2


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
    largest of the channels: from what is shown of the orders below (`against` "last"), or from the first order ("base",
    as in the paper, where a receiver goes on to the end although it has long settled).

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
        return self.levels.at(0, light, values, frames)()

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
        second = self.levels.at(1, light, values, frames)(None, (0, first))
        reached.fill_(self.orders[1])
        threshold = white.unsqueeze(-1)
        # What is shown, what the highest order that was evaluated gives, and what that changed.
        total, radiance, difference = second, second, self._difference(second, first, None)
        weights: list[Tensor] = []
        for level in range(2, len(self.orders)):
            last = None if before is None else before.weights[level - 2]
            weight = self.gate(difference, threshold, last)
            weight = weight * weights[-1] if weights else weight
            chosen = _any(weight > 0).nonzero()[:, 0]
            if not len(chosen):
                weights += [torch.zeros_like(weight)] * (len(self.orders) - level)
                break
            shown, at = total if self.against == "last" else first, self.levels.at(level, light, values, frames)

            def evaluated(
                some: Tensor, below: tuple[int, Tensor], level: int = level, shown: Tensor = shown, at: Level = at
            ) -> None:
                nonlocal radiance, difference
                found = at(some, below)
                radiance = radiance.index_copy(-1, some, found)
                difference = difference.index_copy(-1, some, self._difference(found, receivers_of(shown, some), some))
                reached[some] = self.orders[level]

            difference = torch.zeros_like(weight)
            evaluated(chosen, (level - 1, receivers_of(radiance, chosen)))
            if self.grow and self.neighbours is not None:
                unseen = torch.ones(len(reached), dtype=torch.bool, device=reached.device)
                unseen[chosen] = False
                changing = weight * self.gate(difference, threshold, None)
                edge = chosen[_any(changing > 0)[chosen]]
                # Until little gains: the product of the steps along the best way from where the level began.
                while len(edge) > FEWEST * len(reached):
                    edge = self.neighbours.around(edge, _any(weight < 1))
                    new = edge[unseen[edge]]
                    if len(new):
                        unseen[new] = False
                        evaluated(new, (1, receivers_of(second, new)))
                    made, held = receivers_of(difference, edge), receivers_of(weight, edge)
                    strength = self.gate(made, threshold, None if last is None else receivers_of(last, edge))
                    strength = torch.maximum(held, strength * self.neighbours.largest(changing, edge))
                    going_on = strength * self.gate(made, threshold, None)
                    weight = weight.index_copy(-1, edge, strength)
                    changing = changing.index_copy(-1, edge, going_on)
                    edge = edge[_any((strength - held > LEAST) & (going_on > LEAST))]
            total = torch.lerp(total, radiance, weight.unsqueeze(-2))
            weights.append(weight)
        region = Region(tuple(each.detach() for each in weights), reached)
        if self.rings and weights and self.neighbours is not None:
            within = torch.stack(weights).amax(0)
            total = second + self._surrounded(total - second, within)
        return total * self.layer.weight.T, region

    def _difference(self, one: Tensor, other: Tensor, receivers: Tensor | None) -> Float[Tensor, "*B g"]:
        weight = self.layer.weight
        if receivers is not None and len(weight) > 1:
            weight = weight[receivers]
        return ((one - other) * weight.T).abs().amax(-2)

    def _surrounded(self, added: Float[Tensor, "*B 3 G"], within: Float[Tensor, "*B G"]) -> Float[Tensor, "*B 3 G"]:
        """What a region adds, by how much of it receivers are `within`, with rings around it of what neighbours add."""
        assert self.neighbours is not None
        own, free, some = added, (1 - within).unsqueeze(-2), _any(within > 0)
        for _ in range(self.rings):
            some = some | self.neighbours.beside(some)
            edge = (some & _any(within < 1)).nonzero()[:, 0]
            if not len(edge):
                break
            spread = self.neighbours.mean(added, edge) * free[..., edge]
            added = own.index_add(-1, edge, spread)
        return added


def _any(inside: Tensor) -> Tensor:
    """Of `[*B, G]` whether any light says so, `[G]`."""
    return inside if inside.ndim == 1 else inside.flatten(0, -2).any(0)
