"""Faces in clusters of clusters: light from afar is gathered from few of them instead of from all faces."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from torchprt.brdf import Dipole

LEAF = 8
"""Faces in a cluster that is split no further, at most."""
NEAR = 4.0
"""Faces nearer than so many times their size are integrated over; others are a point at their middle."""
NOTHING = 1e-4
"""Clusters that cannot send more than this part of the reflectance of a half-space, were all of the body as near, are
not split for their error."""


@dataclass(frozen=True, eq=False)
class Tree:
    """A full binary tree of clusters of points that have an area, and below it the points themselves.

    Items are the `2 leaves - 1` clusters, level by level from the one of all, then the points in the order of the
    leaves: `centre [I, 3]` (area-weighted), `radius [I]` about it, `size [I]` of the largest face. `order [n]` is the
    point of each place, some of them twice so that all leaves are full; those have a `share` of 0, others 1."""

    order: Int64[Tensor, "n"]
    share: Float64[Tensor, "n"]
    centre: Float64[Tensor, "I 3"]
    radius: Float64[Tensor, "I"]
    size: Float64[Tensor, "I"]
    leaves: int

    @property
    def clusters(self) -> int:
        return 2 * self.leaves - 1

    def sums(self, values: Float[Tensor, "points W"]) -> Float[Tensor, "I W"]:
        """Values of all items, each the sum of its points."""
        points = values[self.order] * self.share.to(values.dtype)[:, None]
        level = points.view(self.leaves, -1, values.shape[1]).sum(1)
        levels = [points, level]
        while len(level) > 1:
            level = level.view(len(level) // 2, 2, -1).sum(1)
            levels.append(level)
        return torch.cat(levels[::-1])


def halved(points: Float64[Tensor, "n 3"], leaves: int) -> Int64[Tensor, "leaves size"]:
    """The points in leaves of one size, halved along the longest axis again and again. n is a multiple of `leaves`, a
    power of two."""
    order = torch.arange(len(points))[None]
    while len(order) < leaves:
        here = points[order]
        axis = (here.amax(1) - here.amin(1)).argmax(-1)
        along = here.gather(2, axis[:, None, None].expand(-1, here.shape[1], 1))[..., 0]
        order = order.gather(1, along.argsort(dim=1, stable=True)).view(2 * len(order), -1)
    return order


def padded(count: int, leaf: int) -> tuple[int, int]:
    """How many leaves of up to `leaf` points, a power of two, and how many points fill them."""
    leaves = 1
    while leaves * leaf < count:
        leaves *= 2
    return leaves, leaves * -(-count // leaves)


def tree_of(points: Float64[Tensor, "p 3"], area: Float64[Tensor, "p"], size: Float64[Tensor, "p"]) -> Tree:
    """The tree of points with an area and a size each."""
    leaves, full = padded(len(points), LEAF)
    place = torch.arange(full) % len(points)
    order = halved(points[place], leaves).flatten()
    share = (order < len(points)).double()
    order = place[order]
    middle, weight, largest = points[order], area[order] * share, size[order]
    centres, radii, sizes = [middle], [torch.zeros(full, dtype=torch.float64)], [largest]
    count = leaves
    while count:
        some, heavy = middle.view(count, -1, 3), weight.view(count, -1, 1)
        whole = heavy.sum(1)
        centre = torch.where(whole > 0, (some * heavy).sum(1) / whole.clamp(min=1e-300), some.mean(1))
        centres.append(centre)
        radii.append((some - centre[:, None]).norm(dim=-1).amax(1))
        sizes.append(largest.view(count, -1).amax(1))
        count //= 2
    return Tree(order, share, torch.cat(centres[::-1]), torch.cat(radii[::-1]), torch.cat(sizes[::-1]), leaves)


def gathered_from(
    tree: Tree,
    source: Dipole,
    centre: Float64[Tensor, "B 3"],
    radius: Float64[Tensor, "B"],
    spread: float,
    area: float,
) -> tuple[Int64[Tensor, "T"], Int64[Tensor, "B1"]]:
    """Which items each of B blocks of receivers gathers from: `items`, block after block, and where each begins.

    A cluster is taken as one if over its extent the profile changes by at most `spread` of its value at the middle, in
    every colour, wherever in the block one stands (or cannot matter, see `NOTHING`), and if none of its faces is
    `NEAR`. So for light that is nowhere negative what is gathered from it errs by at most `spread` of itself.
    """
    shallow = float(source.real.min()) ** 2
    least = NOTHING * source.total / max(area, 1e-300)
    blocks, items = torch.arange(len(centre)), torch.zeros(len(centre), dtype=torch.int64)
    found: list[tuple[Tensor, Tensor]] = []
    while len(blocks):
        apart = (centre[blocks] - tree.centre[items]).norm(dim=-1) - radius[blocks]
        nearest = (apart - tree.radius[items]).clamp(min=0)
        large, middle = source.at_square(nearest**2), source.at_square(apart.clamp(min=0) ** 2)
        takes = ((large <= (1 + spread) * middle) | (large <= least)).all(-1)
        takes &= nearest**2 + shallow >= (NEAR * tree.size[items]) ** 2
        is_leaf = items >= tree.leaves - 1
        found.append((blocks[takes], items[takes]))
        open_leaf = ~takes & is_leaf
        within = len(tree.order) // tree.leaves
        first = tree.clusters + (items[open_leaf] - (tree.leaves - 1)) * within
        each = (first[:, None] + torch.arange(within)).flatten()
        found.append((blocks[open_leaf].repeat_interleave(within), each))
        split = ~takes & ~is_leaf
        # Items of a level follow each other: the children of k are 2 k + 1 and 2 k + 2.
        children = (2 * items[split][:, None] + torch.tensor([1, 2])).flatten()
        blocks, items = blocks[split].repeat_interleave(2), children
    of_block, item = (torch.cat(each) for each in zip(*found, strict=True))
    order = torch.argsort(of_block, stable=True)
    starts = torch.searchsorted(of_block[order], torch.arange(len(centre) + 1))
    return item[order], starts


def squares(points: Float[Tensor, "b 3"], centres: Float[Tensor, "t 3"]) -> Float[Tensor, "b t"]:
    """Square distances, each with the rounding of its own size."""
    found = torch.zeros(len(points), len(centres), dtype=points.dtype)
    for axis in range(3):
        apart = points[:, axis, None] - centres[:, axis]
        found.addcmul_(apart, apart)
    return found


def close(square: Float[Tensor, "b t"], size: Float[Tensor, "t"], source: Dipole) -> Bool[Tensor, "b t"]:
    """Which faces of a `size` are so near that a point at their middle will not do."""
    return square + float(source.real.min()) ** 2 < (NEAR * size) ** 2


def profile_of(square: Float[Tensor, "b t"], source: Dipole, colour: int) -> Float[Tensor, "b t"]:
    """`Dipole.at_square` of one colour, in the precision of the distances, without copies."""
    decay, found = float(source.decay[colour]), torch.zeros_like(square)
    for depth in (float(source.real[colour]), float(source.virtual[colour])):
        from_source = (square + depth**2).sqrt_()
        fallen = (from_source * -decay).exp_()
        fallen.mul_(from_source.mul(decay).add_(1)).div_(from_source.pow(3))
        found.add_(fallen, alpha=depth * float(source.albedo[colour]) / (4 * torch.pi))
    return found
