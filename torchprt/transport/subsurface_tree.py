"""Faces in clusters of clusters: light from afar is gathered from few of them instead of from all faces."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from torchprt.brdf import Dipole

LEAF = 8
"""Faces in a cluster that is split no further, at most."""
NEAR = 2.0
"""Faces nearer than so many times their size are integrated over; others are a point at their middle."""
APART = 2.5
"""Clusters nearer than so many times their radius are split."""
NOTHING = 1e-4
"""Clusters that cannot send more than this part of the reflectance of a half-space, were all of the body as near, are
not split for their error."""


@dataclass(frozen=True, eq=False)
class Tree:
    """A full binary tree of clusters of points that have an area, and below it the points themselves.

    Items are the `2 leaves - 1` clusters, level by level from the one of all, then the points in the order of the
    leaves: `centre [I, 3]` (of the area), `radius [I]` of the middles of faces about it, `moments [I, 6]`, the
    covariance of the area (xx, yy, zz, xy, xz, yz), and `size [I]` of the largest face. `order [n]` is the face of each
    place, some of them twice so that all leaves are full; those have a `share` and a size of 0, others a share of 1."""

    order: Int64[Tensor, "n"]
    share: Float64[Tensor, "n"]
    centre: Float64[Tensor, "I 3"]
    radius: Float64[Tensor, "I"]
    moments: Float64[Tensor, "I 6"]
    size: Float64[Tensor, "I"]
    leaves: int

    @property
    def clusters(self) -> int:
        return 2 * self.leaves - 1

    def sums(
        self, values: Float[Tensor, "f W"], firsts: Float[Tensor, "3 f W"]
    ) -> tuple[Float[Tensor, "I W"], Float[Tensor, "3 I W"]]:
        """What enters all items: the sums of `values` of their faces, and first moments about their middles, of
        `firsts` of the faces about their own."""
        share = self.share.to(values.dtype)[:, None]
        total, moment = values[self.order] * share, firsts[:, self.order] * share
        totals, moments, count, width = [total], [moment], self.leaves, values.shape[1]
        end = len(self.centre) - len(total)
        centre = self.centre[end:]
        while count:
            here = self.centre[end - count : end]
            arm = (centre.view(count, -1, 3) - here[:, None]).to(values.dtype)
            total, moment = total.view(count, -1, width), moment.view(3, count, -1, width)
            moment = moment.sum(2) + torch.einsum("ckx,ckw->xcw", arm, total)
            total, centre, end = total.sum(1), here, end - count
            totals.append(total)
            moments.append(moment)
            count //= 2
        return torch.cat(totals[::-1]), torch.cat(moments[::-1], 1)


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


def tree_of(corners: Float64[Tensor, "f 3 3"], area: Float64[Tensor, "f"], size: Float64[Tensor, "f"]) -> Tree:
    """The tree of faces with an area and a size each."""
    leaves, full = padded(len(corners), LEAF)
    place = torch.arange(full) % len(corners)
    middle = corners.mean(1)
    order = halved(middle[place], leaves).flatten()
    share = (order < len(corners)).double()
    order = place[order]
    weight, centre = area[order] * share, middle[order]
    # Of a triangle: a twelfth of the sum over its corners.
    moments = _products(corners[order] - centre[:, None]).sum(1) / 12
    centres, radii, all_moments, sizes = (
        [centre],
        [torch.zeros(full, dtype=torch.float64)],
        [moments],
        [size[order] * share],
    )
    below, count = centre, leaves
    while count:
        heavy = weight.view(count, -1, 1)
        whole = heavy.sum(1)
        heavy = torch.where(whole[:, None] > 0, heavy / whole.clamp(min=1e-300)[:, None], 1 / heavy.shape[1])
        below, moments = below.view(count, -1, 3), moments.view(count, -1, 6)
        centre = (below * heavy).sum(1)
        moments = ((moments + _products(below - centre[:, None])) * heavy).sum(1)
        centres.append(centre)
        all_moments.append(moments)
        radii.append((middle[order].view(count, -1, 3) - centre[:, None]).norm(dim=-1).amax(1))
        sizes.append(size[order].view(count, -1).amax(1))
        below, weight = centre, whole[:, 0]
        count //= 2
    centre, radius, moments, largest = (torch.cat(each[::-1]) for each in (centres, radii, all_moments, sizes))
    return Tree(order, share, centre, radius, moments, largest, leaves)


def _products(vectors: Float64[Tensor, "*batch 3"]) -> Float64[Tensor, "*batch 6"]:
    x, y, z = vectors.unbind(-1)
    return torch.stack([x * x, y * y, z * z, x * y, x * z, y * z], -1)


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
    every colour, wherever in the block one stands (or cannot matter, see `NOTHING`), and if neither it nor any of its
    faces is near (`APART`, `NEAR`, from the depth of the source). For light that is nowhere negative what is gathered
    from it would so err by at most `spread` of itself if all were at its middle; with its moments it is far less.
    """
    shallow = float(source.real.min()) ** 2
    least = NOTHING * source.total / max(area, 1e-300)
    blocks, items = torch.arange(len(centre)), torch.zeros(len(centre), dtype=torch.int64)
    found: list[tuple[Tensor, Tensor]] = []
    while len(blocks):
        apart = (centre[blocks] - tree.centre[items]).norm(dim=-1) - radius[blocks]
        nearest = (apart - tree.radius[items]).clamp(min=0)
        large, middle = source.at_square(nearest**2), source.at_square((nearest + tree.radius[items]) ** 2)
        takes = ((large <= (1 + spread) * middle) | (large <= least)).all(-1)
        takes &= nearest**2 + shallow >= torch.maximum(NEAR * tree.size[items], APART * tree.radius[items]) ** 2
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


def squares(
    points: Float[Tensor, "b 3"], centres: Float[Tensor, "t 3"], moments: Float[Tensor, "t 6"]
) -> tuple[Float[Tensor, "b t"], Float[Tensor, "b t"], list[Float[Tensor, "b t"]]]:
    """Square distances, each with the rounding of its own size, the vectors along themselves through `moments`, and
    the vectors, x, y and z."""
    x, y, z = vectors = [points[:, axis, None] - centres[:, axis] for axis in range(3)]
    xx, yy, zz, xy, xz, yz = moments.unbind(-1)
    along = (x * xx).addcmul_(y, 2 * xy).addcmul_(z, 2 * xz).mul_(x)
    along.addcmul_((y * yy).addcmul_(z, 2 * yz), y)
    square = z.square()
    along.addcmul_(square, zz)
    return square.addcmul_(x, x).addcmul_(y, y), along, vectors


def close(square: Float[Tensor, "b t"], size: Float[Tensor, "t"], source: Dipole) -> Bool[Tensor, "b t"]:
    """Which faces of a `size` are so near that a point at their middle will not do."""
    return square + float(source.real.min()) ** 2 < (NEAR * size) ** 2


def profile_over(
    square: Float[Tensor, "b t"], along: Float[Tensor, "b t"], spread: Float[Tensor, "t"], source: Dipole, colour: int
) -> tuple[Float[Tensor, "b t"], Float[Tensor, "b t"]]:
    """The mean of the profile of one colour over items, to the second order of their extent, and -2 R' below, which
    times x - c is how it changes as c does.

    With s the square of a distance, R the profile, x - c from the middle of an item with covariance S, `along` = (x -
    c) S (x - c) and `spread` the trace of S: R(s) + R'(s) tr S + 2 R''(s) (x - c) S (x - c). Of one point of light R is
    z e^(-a) (1 + a) / d^3 with d^2 = s + z^2 and a = decay d; its derivatives are -z e^(-a) (3 + 3 a + a^2) / (2 d^5)
    and z e^(-a) (15 + 15 a + 6 a^2 + a^3) / (4 d^7).
    """
    decay, found, change = float(source.decay[colour]), torch.zeros_like(square), torch.zeros_like(square)
    for depth in (float(source.real[colour]), float(source.virtual[colour])):
        inverse = (square + depth**2).rsqrt_()
        # Beyond this nothing is left, and powers of it leave the range of float32.
        a = inverse.reciprocal().mul_(decay).clamp_(max=100)
        fallen = torch.exp(-a)
        inverse2 = inverse.square()
        fallen.mul_(inverse).mul_(inverse2)
        # From the highest power down.
        bent = (along * inverse2).mul_((a + 6).mul_(a).add_(15).mul_(a).add_(15))
        steep = (a + 3).mul_(a).add_(3).mul_(inverse2)
        bent.mul_(inverse2).addcmul_(steep, spread, value=-1)
        fallen.mul_(depth * float(source.albedo[colour]) / (4 * torch.pi))
        found.addcmul_(fallen, bent.mul_(0.5).add_(a).add_(1))
        change.addcmul_(fallen, steep)
    return found, change
