"""The tasks of the bake of a volume: what comes from the light, and what cells send to each other."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import basis
from torchprt.transport.directions import hemisphere
from torchprt.transport.sweep import attenuated, scattered
from torchprt.transport.task import Once, Task
from torchprt.transport.track_surfaces import Blockers
from torchprt.transport.tracks import Medium, Slices, Tracks, steepest, tracks

GROUPS = [(axis, side) for axis in range(3) for side in (1, -1)]
"""Directions by their steepest axis and the side of it that they are on: such tracks are swept together."""
BOTH = 2
"""The two halves of a set of directions."""
# Numbers of a slice that are computed at once: enough that calls cost little, few enough to stay in the cache.
_AT_ONCE = 1 << 19


@dataclass
class Directions:
    """Directions in pairs of opposites, the solid angle that each stands for, and where its lattice of tracks lies."""

    places: Float[Tensor, "D 3"]
    weights: Float[Tensor, "D"]
    offsets: Float[Tensor, "D 2"]


def direction_set(count: int, seed: int, half: int, degree: int) -> Directions:
    """About `count` directions, or every other pair of them (half 0 or 1): the mean over one half is a check of that
    over the other.

    Their weights, all but equal, integrate harmonics up to `degree` exactly, or up to what so many directions can:
    light that is the same everywhere must not change on its way.
    """
    pairs = 2 * max(1, math.ceil(count / 4))
    number = torch.arange(pairs, dtype=torch.float64)
    # As even over the square as the directions are over the sphere, and independent of them.
    offsets = torch.frac((number + 0.5)[:, None] * torch.tensor([0.7548776662466927, 0.5698402909980532]).double())
    chosen = slice(None) if half == BOTH else slice(half, None, 2)
    above, offsets = hemisphere(pairs, seed)[chosen], offsets[chosen]
    # Odd harmonics vanish over pairs; half as many conditions as pairs leave the weights near to equal.
    even = [band for band in range(0, degree + 1, 2) if (band + 1) * (band + 2) / 2 <= max(1, len(above) / 2)]
    rows = torch.cat([torch.arange(band * band, (band + 1) ** 2) for band in even])
    table = basis(above, even[-1] + 1).T[rows]
    equal = torch.full((len(above),), 4 * math.pi / len(above), dtype=torch.float64)
    missing = -table @ equal
    missing[0] += math.sqrt(4 * math.pi)
    weights = (equal + table.T @ torch.linalg.solve(table @ table.T, missing)) / 2
    return Directions(torch.cat([above, -above]), weights.repeat(2), offsets.repeat(2, 1))


@dataclass
class Inside:
    """What the bake of a volume is made of.

    `moments`: of the phase function, one for each band that is followed. `blockers`: surfaces that block, if any.
    """

    medium: Medium
    order: int
    moments: tuple[float, ...]
    rays: int
    seed: int
    blockers: Blockers | None = None
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    @property
    def rows(self) -> int:
        """Functions of the direction that are recorded: one if all directions are alike."""
        return len(self.moments) ** 2

    def gathered(self, directions: Float[Tensor, "D 3"]) -> Float[Tensor, "M D"]:
        """What arriving radiance is integrated with: the mean over the sphere, or the harmonics."""
        if self.rows == 1:
            return torch.full((1, len(directions)), 1 / (4 * math.pi), dtype=directions.dtype)
        return basis(directions, len(self.moments)).T

    def sent(self, directions: Float[Tensor, "D 3"]) -> Float[Tensor, "D M"] | None:
        """What the cells send against the directions, of what has arrived in each row."""
        if self.rows == 1:
            return None
        bands = torch.repeat_interleave(torch.tensor(self.moments), torch.arange(1, 2 * len(self.moments), 2))
        return (basis(directions, len(self.moments)) * bands).to(torch.float32)

    @property
    def slices(self) -> list[Slices]:
        """The cells in slices across each axis."""
        return self.once("slices", lambda: [self.medium.slices(axis) for axis in range(3)])


@dataclass(frozen=True)
class Sweep(Task):
    """One of `GROUPS`, of `rays` directions all together, one half of them or `BOTH`. `rows`: columns of the light."""

    group: int
    rays: int
    half: int

    @property
    def work(self) -> int:
        return max(1, self.rays // len(GROUPS))

    def along(self, inside: Inside, columns: int) -> Iterator[tuple[Tensor, Tensor, Tracks]]:
        """Directions in batches, what each stands for, and their tracks."""
        axis, side = GROUPS[self.group]
        slices, medium = inside.slices[axis], inside.medium
        degree = inside.order + len(inside.moments) - 2
        chosen = direction_set(self.rays, inside.seed, self.half, max(2, degree))
        here = (steepest(medium, chosen.places) == axis) & (chosen.places[:, axis] * side > 0)
        index = torch.nonzero(here)[:, 0]
        fullest = max(b - a for a, b in itertools.pairwise(slices.starts))
        for part in index.split(max(1, _AT_ONCE // (fullest * columns))) if len(index) else ():
            directions = chosen.places[part]
            yield directions, chosen.weights[part], tracks(medium, slices, directions, chosen.offsets[part])


@dataclass(frozen=True)
class Enter(Sweep):
    """What "arrives" `[M, G, N]` from the light, cells in the order of the medium: the sum over its directions."""

    def compute(self, inside: Inside) -> dict[str, Tensor]:
        slices = inside.slices[GROUPS[self.group][0]]
        columns = inside.order**2
        arrives = torch.zeros(inside.rows, len(slices.order), columns)
        for directions, weights, along in self.along(inside, 1):
            light, cuts = torch.ones(len(along) * along.count), {}
            if inside.blockers is not None:
                light = inside.blockers.light(slices, along, directions)
                cuts = inside.blockers.cuts(slices, along, directions)
            left = attenuated(inside.medium, slices, along, light, cuts)
            harmonics = (basis(directions, inside.order) * weights[:, None]).to(torch.float32)
            for row, values in zip(arrives, inside.gathered(directions).to(torch.float32), strict=True):
                row.addmm_(left.T, values[:, None] * harmonics)
        return {"arrives": unsorted(arrives, slices)}


@dataclass(frozen=True)
class Scatter(Sweep):
    """What "arrives" `[M, G, n]` from all cells of what they send, `emission [M, G, N]`, in the columns `rows`: the sum
    over its directions."""

    def compute(self, inside: Inside, emission: Float[Tensor, "M G W"]) -> dict[str, Tensor]:
        slices = inside.slices[GROUPS[self.group][0]]
        emission = emission[:, slices.order, self.rows].contiguous()
        arrives = torch.zeros_like(emission)
        for directions, weights, along in self.along(inside, emission.shape[2]):
            cuts = {} if inside.blockers is None else inside.blockers.cuts(slices, along, directions)
            gathered = (inside.gathered(directions) * weights).to(torch.float32)
            scattered(inside.medium, slices, along, emission, inside.sent(directions), gathered, cuts, arrives)
        return {"arrives": unsorted(arrives, slices)}


def unsorted(values: Float[Tensor, "M G N"], slices: Slices) -> Float[Tensor, "M G N"]:
    """Values of cells in slices in the order of the medium."""
    found = torch.empty_like(values)
    found[:, slices.order] = values
    return found
