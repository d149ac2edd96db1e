"""Interreflection: what each receiver hits is kept once, then every bounce is a sparse product."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchprt.trace import Hits, Mirrors, Tracer
from torchprt.transport.diffuse import cosine_weights, to_world
from torchprt.transport.mirrors import by_way_of_mirrors
from torchprt.transport.receivers import Receivers
from torchprt.transport.through_volume import ThroughVolume


@dataclass
class Gather:
    """Sparse rows `G [v, V]`: how much of the exit radiance of receiver q arrives at p, cosine and 1/pi included.

    `S = v + 1`: entries of row p are `offsets[p]` to `offsets[p + 1]` of `sources` q and `weights`. Indices are
    int32, because the product is ten times faster with them than with int64. A = 1, or 3 where coloured mirrors weigh
    the three channels of W differently.
    """

    offsets: Int[Tensor, "S"]
    sources: Int[Tensor, "E"]
    weights: Float[Tensor, "E A"]

    def __matmul__(self, exitant: Float[Tensor, "V W"]) -> Float[Tensor, "v W"]:
        if len(self.sources) == 0:
            return exitant.new_zeros(len(self.offsets) - 1, exitant.shape[1])
        colours, sources = self.weights.shape[1], self.sources
        if colours > 1 and len(exitant) > 4 * len(sources):
            # A channel must be copied: of the rows that are met alone.
            met, sources = sources.unique(return_inverse=True)
            exitant, sources = exitant[met.long()], sources.to(torch.int32)
        columns = exitant.unflatten(1, (colours, -1))
        return torch.cat(
            [self._sum(columns[:, a], sources, weights) for a, weights in enumerate(self.weights.unbind(1))], 1
        )

    def _sum(
        self, exitant: Float[Tensor, "V w"], sources: Int[Tensor, "E"], weights: Float[Tensor, "E"]
    ) -> Float[Tensor, "v w"]:
        return torch.nn.functional.embedding_bag(
            sources,
            exitant.contiguous(),
            self.offsets,
            mode="sum",
            per_sample_weights=weights.contiguous(),
            include_last_offset=True,
        )


@dataclass
class Surfaces:
    """Which receivers reflect at the corners of every triangle: `front [F, 3]` and `back [F, 3]`, -1 where that side
    reflects nothing (a blocker, or the back of a one-sided material). `mirrors`: the faces that are mirrors, if any;
    `volume`: what light goes through on its way from one to another, if anything."""

    front: Int[Tensor, "F 3"]
    back: Int[Tensor, "F 3"]
    mirrors: Mirrors | None = None
    volume: ThroughVolume | None = None

    @property
    def reflect(self) -> tuple[Bool[Tensor, "F"], Bool[Tensor, "F"]]:
        """Whether the front and the back of every triangle reflect."""
        return (self.front >= 0).any(-1), (self.back >= 0).any(-1)

    def senders(
        self, triangle: Int[Tensor, "E"], u: Float[Tensor, "E"], v: Float[Tensor, "E"], front: Bool[Tensor, "E"]
    ) -> tuple[Int[Tensor, "E K"], Float[Tensor, "E K"]]:
        """The receivers whose exit radiance makes up that of points on triangles, -1 for none, and their weights."""
        corners = torch.where(front[:, None], self.front[triangle], self.back[triangle])
        return corners, torch.stack([1 - u - v, u, v], -1)

    def contents(self) -> list[Tensor]:
        """All that decides the senders and that the geometry does not say."""
        return []

    @property
    def channels(self) -> int:
        """Of direct light: 3 if it may come by way of coloured mirrors or cells."""
        return max(1 if each is None else each.channels for each in (self.mirrors, self.volume))

    @property
    def sent(self) -> bool:
        """Whether direct light needs more than what is visible: it comes by way of mirrors, or from cells."""
        return self.mirrors is not None or (self.volume is not None and self.volume.emission is not None)


def shadowed_with_hits(
    tracer: Tracer,
    surfaces: Surfaces,
    receivers: Receivers,
    directions: Float[Tensor, "D 3"],
    project: Float[Tensor, "N D"],
) -> tuple[Float[Tensor, "A N v"], Gather, Float[Tensor, "v"]]:
    """Shadowed transfer of a chunk and its gather rows, from one set of traced rays. Pure, as `diffuse.shadowed`.

    The last is what was cut off among mirrors, as a share of what could arrive.
    Source: Sloan, Kautz and Snyder 2002, section 5, shadow and interreflection passes.
    """
    turned = receivers.frames()
    rays = directions.to(torch.float32)
    weights = cosine_weights(directions).to(torch.float32)
    local = torch.empty(len(project), len(receivers), dtype=torch.float32)
    more = torch.zeros(surfaces.channels if surfaces.sent else 0, len(project), len(receivers))
    lost = torch.zeros(len(receivers))
    parts: list[tuple[Tensor, Tensor, Tensor]] = []
    for rows in receivers.blocks(len(rays)):
        hits = tracer.hits(receivers.origins[rows], turned[rows], rays)
        lit = receivers.normals[rows].abs().sum(-1) > 0
        visible, share = (hits.triangle < 0).to(torch.float32), None
        if surfaces.mirrors is not None:
            seen = by_way_of_mirrors(tracer, surfaces.mirrors, hits, turned[rows], rays)
            more[..., rows] = seen.direct(weights, math.isqrt(len(project)), len(lit)) * lit
            lost[rows] = seen.lost(weights, len(lit)) * lit
            hits, share = seen.hits, seen.shares(len(lit), len(rays))
        if surfaces.volume is not None:
            through = surfaces.volume.seen(tracer, receivers.origins[rows], turned[rows], rays, hits, weights)
            visible, share = visible * through.left, through.left[..., None]
            more[..., rows] = through.direct() * lit
        local[:, rows] = project @ visible.T
        parts.append(_entries(hits, surfaces, weights, lit, share))
    counts, sources, values = (torch.cat(part) for part in zip(*parts, strict=True))
    offsets = torch.zeros(len(receivers) + 1, dtype=torch.int32)
    offsets[1:] = torch.cumsum(counts, 0)
    direct = to_world(local, turned, receivers.normals)[None]
    return direct + more if surfaces.sent else direct, Gather(offsets, sources, values), lost


def _entries(
    hits: Hits, surfaces: Surfaces, weights: Tensor, lit: Tensor, share: Tensor | None
) -> tuple[Tensor, Tensor, Tensor]:
    """Entries a receiver, their sources and weights, of a block. `share [v, D, A]`: what is left of each ray."""
    row, column = torch.nonzero((hits.triangle >= 0) & lit[:, None], as_tuple=True)
    met = (part[row, column] for part in (hits.triangle.long(), hits.u, hits.v, hits.front))
    senders, parts = surfaces.senders(*met)
    values = parts * weights[column][:, None]
    reflects = senders >= 0
    counts = torch.bincount(row, weights=reflects.sum(-1).to(torch.float64), minlength=len(lit)).long()
    values = values[..., None] if share is None else values[..., None] * share[row, column][:, None]
    return counts, senders[reflects].to(torch.int32), values[reflects]
