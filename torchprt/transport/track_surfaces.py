"""Surfaces in the way of tracks through cells: they are black, and light ends on them."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.trace import Tracer
from torchprt.transport.sweep import Cuts
from torchprt.transport.tracks import Slices, Tracks

# So many surfaces are looked for on one track; behind the last that many it is dark anyway, but for gaps between them.
_SURFACES = 64


@dataclass
class Blockers:
    """What blocks, and where the cells are in its world: their lowest `corner` and the sides of one, float64."""

    tracer: Tracer
    corner: Float[Tensor, "3"]
    spacing: Float[Tensor, "3"]
    # Every pass goes along the same tracks.
    known: dict[Hashable, Cuts] = field(default_factory=dict, init=False, repr=False, compare=False)

    def light(self, slices: Slices, along: Tracks, directions: Float[Tensor, "D 3"]) -> Float[Tensor, "T"]:
        """What enters on each track of a light of 1: nothing where a surface outside is in its way."""
        escapes = []
        for start, direction in zip(self._starts(slices, along), directions, strict=True):
            seen = self.tracer.visibility(self._origins(start, direction), _same(len(start)), _single(direction))
            escapes.append(seen[:, 0])
        return torch.cat(escapes)

    def cuts_of(self, key: Hashable, slices: Slices, along: Tracks, directions: Float[Tensor, "D 3"]) -> Cuts:
        """The `cuts` of tracks that go by this name, looked for once; four bytes a surface on a track are kept."""
        if key not in self.known:
            self.known[key] = self.cuts(slices, along, directions)
        return self.known[key]

    def cuts(self, slices: Slices, along: Tracks, directions: Float[Tensor, "D 3"]) -> Cuts:
        """Where tracks end on surfaces: at the nearest border of a cell on its way. Another begins there, dark."""
        depth = len(slices.starts) - 1
        found: dict[int, list[Tensor]] = {}
        for number, (start, direction) in enumerate(zip(self._starts(slices, along), directions, strict=True)):
            track = torch.arange(len(start))
            place = start
            for _ in range(_SURFACES):
                hits = self.tracer.hits(self._origins(place, -direction), _same(len(place)), _single(-direction))
                met = torch.nonzero(hits.triangle[:, 0] >= 0)[:, 0]
                corners = self.tracer.corners()[hits.triangle[met, 0].long()]
                u, v = hits.u[met, 0].double(), hits.v[met, 0].double()
                place = (corners * torch.stack([1 - u - v, u, v], -1)[..., None]).sum(1)
                step = (place[:, slices.axis] - self.corner[slices.axis]) / self.spacing[slices.axis]
                step = (depth - step if along.backward else step).clamp(min=0)
                within = step < depth
                track, place, step = track[met][within], place[within], step[within]
                if not len(track):
                    break
                slice_number = step.floor().long()
                borders = torch.nn.functional.pad(along.parts[number, slice_number].cumsum(-1), (1, 0))
                nearest = (borders - (step - slice_number)[:, None]).abs().argmin(-1)
                event = 3 * slice_number + nearest
                for each in event.unique().tolist():
                    found.setdefault(each, []).append(track[event == each] + number * along.count)
        return {step: torch.cat(parts).to(torch.int32) for step, parts in found.items()}

    def _starts(self, slices: Slices, along: Tracks) -> Float[Tensor, "D T 3"]:
        """Where tracks enter the first slice, in the world."""
        depth = len(slices.starts) - 1
        number = torch.arange(along.count)
        rows = torch.stack([number // along.width, number % along.width], -1) + torch.tensor(along.corner)
        place = torch.zeros(len(along), along.count, 3, dtype=torch.float64)
        place[..., slices.axis] = depth if along.backward else 0
        place[..., slices.others] = rows + (along.offsets - depth / 2 * along.slopes)[:, None]
        return self.corner + place * self.spacing

    def _origins(self, place: Tensor, away: Tensor) -> Tensor:
        # Off what was met, however large: a triangle's size is not known here, that of a cell is as good.
        return self.tracer.origins(place, away.expand(len(place), 3), float(self.spacing.max()))


def _same(count: int) -> Float[Tensor, "v 3 3"]:
    return torch.eye(3).expand(count, 3, 3)


def _single(direction: Tensor) -> Float[Tensor, "1 3"]:
    return direction.to(torch.float32)[None]
