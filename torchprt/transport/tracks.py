"""Parallel tracks through a grid of cells: what light loses and gains on its way, for all cells at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass
class Slices:
    """The cells in slices across one axis: `order [G]` of them, where each slice `starts`, and their places in it."""

    axis: int
    order: Int[Tensor, "G"]
    starts: Sequence[int]
    across: Int[Tensor, "G 2"]

    @property
    def others(self) -> tuple[int, int]:
        """The axes that a slice lies along."""
        return (1, 2) if self.axis == 0 else (0, 2) if self.axis == 1 else (0, 1)


@dataclass
class Medium:
    """Cells that hold something, in units in which the geometric mean of a cell's sides is 1.

    `places [G, 3]`: which of `shape` they are; `extinction [G]` float32; `spacing`: the sides of a cell.
    """

    places: Int[Tensor, "G 3"]
    shape: tuple[int, int, int]
    extinction: Float[Tensor, "G"]
    spacing: Float[Tensor, "3"]

    def slices(self, axis: int) -> Slices:
        """The cells in slices across an axis."""
        along = self.places[:, axis]
        order = torch.argsort(along, stable=True)
        starts = torch.searchsorted(along[order].contiguous(), torch.arange(self.shape[axis] + 1)).tolist()
        others = [other for other in range(3) if other != axis]
        return Slices(axis, order, starts, self.places[order][:, others])


def steepest(medium: Medium, directions: Float[Tensor, "D 3"]) -> Int[Tensor, "D"]:
    """The axis along which a ray crosses the most cells."""
    return (directions / medium.spacing).abs().argmax(-1)


@dataclass
class Tracks:
    """A lattice of parallel tracks for each of D directions, one through each face of a cell across their steepest
    axis; light comes from the direction and goes on against it, from slice to slice.

    In a slice a track crosses three cells at most, and all tracks alike: each cell of it is crossed by three of them,
    by `parts [D, S, 3]` of the way through a slice, which sum to 1, `length [D]`. So every cell is sampled by its
    volume exactly, for every direction: what a cell takes, sends and lets through sums to what comes, without error.
    `first [D, S, 3]`: the number of the track that crosses a cell at (0, 0) of the slice; `width` of the lattice, and
    `count` of its tracks. `backward`: whether slices are met from the last to the first.

    Laws: the tracks of -d are those of d, the other way round.
    Source: the method of characteristics of neutron transport (Askew 1972), for the rays of Sloan, Kautz and Snyder
    2002, section 7.
    """

    parts: Float[Tensor, "D S 3"]
    first: Int[Tensor, "D S 3"]
    length: Float[Tensor, "D"]
    width: int
    count: int
    backward: bool
    corner: tuple[int, int]
    """The place in a slice at the middle of the grid at which the first track is, less its offset."""
    slopes: Float[Tensor, "D 2"]
    offsets: Float[Tensor, "D 2"]

    def __len__(self) -> int:
        return len(self.length)

    def met(self, slices: Slices) -> Iterator[tuple[int, slice]]:
        """Slices with anything in them in the order in which they are met: when, and which cells."""
        depth = len(slices.starts) - 1
        for step in range(depth):
            number = depth - 1 - step if self.backward else step
            rows = slice(slices.starts[number], slices.starts[number + 1])
            if rows.stop > rows.start:
                yield step, rows

    def numbers(self, slices: Slices, rows: slice, step: int, part: int) -> Int[Tensor, "D g"]:
        """Of the tracks that cross the cells `rows` of a slice."""
        across = slices.across[rows]
        return self.first[:, step, part, None] + (across[:, 0] * self.width + across[:, 1])

    def taken(self, medium: Medium, slices: Slices, rows: slice, step: int, part: int) -> Float[Tensor, "D g"]:
        """The share of light that those cells take from those tracks, `1 - e^-depth`."""
        way = -(self.parts[:, step, part] * self.length).to(torch.float32)
        return -torch.expm1(way[:, None] * medium.extinction[slices.order[rows]])


def tracks(medium: Medium, slices: Slices, directions: Float[Tensor, "D 3"], offsets: Float[Tensor, "D 2"]) -> Tracks:
    """Tracks along directions of which that axis is the steepest, and which all point to the same side of it.

    `offsets`, in [0, 1): where the lattice of each lies, float64.
    """
    here, (first, second) = slices.axis, slices.others
    travel = -directions / medium.spacing
    step = travel[:, here].abs()
    slopes = torch.stack([travel[:, first], travel[:, second]], -1) / step[:, None]
    depth = medium.shape[here]
    # About the middle, so that the other way round they are the same.
    at = offsets[:, None] + (torch.arange(depth, dtype=torch.float64)[:, None] - depth / 2) * slopes[:, None]
    cell = at.floor()
    within = at - cell
    beyond = within + slopes[:, None]
    moved = (beyond >= 1).long() - (beyond < 0).long()
    slope = torch.where(slopes == 0, 1, slopes)[:, None]
    crossing = torch.where(moved > 0, (1 - within) / slope, torch.where(moved < 0, -within / slope, 1)).clamp(0, 1)
    earlier, later = crossing.amin(-1), crossing.amax(-1)
    parts = torch.stack([earlier, later - earlier, 1 - later], -1)
    sooner = torch.nn.functional.one_hot(crossing.argmin(-1), 2)
    # A cell is crossed by the track that entered the slice at its own place, and by two that entered beside it.
    entered = torch.stack([cell.long(), cell.long() + moved * sooner, cell.long() + moved], -2)
    low, high = -entered.amax((0, 1, 2)), -entered.amin((0, 1, 2))
    rows, width = (medium.shape[axis] + int(b - a) for axis, a, b in zip((first, second), low, high, strict=True))
    corner = (int(low[0]), int(low[1]))
    place = -entered - low
    start = torch.arange(len(directions))[:, None, None] * (rows * width)
    return Tracks(
        parts,
        place[..., 0] * width + place[..., 1] + start,
        1 / step,
        width,
        rows * width,
        bool(travel[0, here] < 0),
        corner,
        slopes,
        offsets,
    )
