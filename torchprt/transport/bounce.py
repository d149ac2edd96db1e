"""Interreflection: what each receiver hits is kept once, then every bounce is a sparse product."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.trace import Hits, Tracer
from torchprt.transport.diffuse import cosine_weights, to_world
from torchprt.transport.receivers import Receivers


@dataclass
class Gather:
    """Sparse rows `G [v, V]`: how much of the exit radiance of receiver q arrives at p, cosine and 1/pi included.

    `S = v + 1`: entries of row p are `offsets[p]` to `offsets[p + 1]` of `sources` q and `weights`. Indices are
    int32, because the product is ten times faster with them than with int64.
    """

    offsets: Int[Tensor, "S"]
    sources: Int[Tensor, "E"]
    weights: Float[Tensor, "E"]

    def __matmul__(self, exitant: Float[Tensor, "V W"]) -> Float[Tensor, "v W"]:
        if len(self.sources) == 0:
            return exitant.new_zeros(len(self.offsets) - 1, exitant.shape[1])
        return torch.nn.functional.embedding_bag(
            self.sources,
            exitant,
            self.offsets,
            mode="sum",
            per_sample_weights=self.weights,
            include_last_offset=True,
        )


@dataclass
class Surfaces:
    """Which receivers reflect at the corners of every triangle: `front [F, 3]` and `back [F, 3]`, -1 where that side
    reflects nothing (a blocker, or the back of a one-sided material)."""

    front: Int[Tensor, "F 3"]
    back: Int[Tensor, "F 3"]


def shadowed_with_hits(
    tracer: Tracer,
    surfaces: Surfaces,
    receivers: Receivers,
    directions: Float[Tensor, "D 3"],
    project: Float[Tensor, "N D"],
) -> tuple[Float[Tensor, "N v"], Gather]:
    """Shadowed transfer of a chunk and its gather rows, from one set of traced rays. Pure, as `diffuse.shadowed`.

    Source: Sloan, Kautz and Snyder 2002, section 5, shadow and interreflection passes.
    """
    turned = receivers.frames()
    rays = directions.to(torch.float32)
    weights = cosine_weights(directions).to(torch.float32)
    local = torch.empty(len(project), len(receivers), dtype=torch.float32)
    parts: list[tuple[Tensor, Tensor, Tensor]] = []
    for rows in receivers.blocks(len(rays)):
        hits = tracer.hits(receivers.origins[rows], turned[rows], rays)
        local[:, rows] = project @ (hits.triangle < 0).to(torch.float32).T
        lit = receivers.normals[rows].abs().sum(-1) > 0
        parts.append(_entries(hits, surfaces, weights, lit))
    counts, sources, values = (torch.cat(part) for part in zip(*parts, strict=True))
    offsets = torch.zeros(len(receivers) + 1, dtype=torch.int32)
    offsets[1:] = torch.cumsum(counts, 0)
    return to_world(local, turned, receivers.normals), Gather(offsets, sources, values)


def _entries(hits: Hits, surfaces: Surfaces, weights: Tensor, lit: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Entries a receiver, their sources and weights, for a block of receivers."""
    row, column = torch.nonzero((hits.triangle >= 0) & lit[:, None], as_tuple=True)
    triangle = hits.triangle[row, column].long()
    corners = torch.where(hits.front[row, column][:, None], surfaces.front[triangle], surfaces.back[triangle])
    u, v = hits.u[row, column], hits.v[row, column]
    values = torch.stack([1 - u - v, u, v], -1) * weights[column][:, None]
    reflects = corners >= 0
    counts = torch.bincount(row, weights=reflects.sum(-1).to(torch.float64), minlength=len(lit)).long()
    return counts, corners[reflects].to(torch.int32), values[reflects]
