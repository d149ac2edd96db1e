"""Mirrors in a bake: light that comes to receivers by way of them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.sh import basis
from torchprt.trace import REFLECTIONS, Hits, Mirrors, Reflected, Tracer, follow

# The share of light that may be cut off among mirrors before it is said.
CUT = 1e-3
# Numbers of a basis at a time.
_NUMBERS = 1 << 22


class MirrorWarning(UserWarning):
    """Light that was still among mirrors after all reflections, and was left out."""


def mirrors_of(geometry: Geometry) -> Mirrors | None:
    """The mirrors of a scene, None if there are none."""
    if not len(geometry.reflectance):
        return None
    return Mirrors(geometry.mirror, geometry.reflectance, geometry.mirror_normals)


@dataclass(frozen=True, eq=False)
class ByMirrors:
    """What a block of receivers sees by way of mirrors: `hits`, with the last surface of each ray that was reflected in
    place of its first, and of these rays receiver `row [E]`, direction of the bake `column [E]`, and where they went.

    A ray that left the scene has no hit any more, and yet sees the light of another direction than its own.
    """

    hits: Hits
    row: Int[Tensor, "E"]
    column: Int[Tensor, "E"]
    rays: Reflected

    def escaped(self) -> Iterator[tuple[Int[Tensor, "e"], Int[Tensor, "e"], Tensor, Float[Tensor, "e 3"]]]:
        """Row, column, share `[e, A]` and direction of the rays that left the scene, some at a time."""
        chosen = torch.nonzero(self.rays.triangle < 0)[:, 0]
        for some in chosen.split(_NUMBERS // 64):
            yield self.row[some], self.column[some], self.rays.share[some], self.rays.direction[some]

    def direct(self, weights: Float[Tensor, "D"], order: int, receivers: int) -> Float[Tensor, "A N v"]:
        """`sum_s weights(s) share y_i(where s came to)`, in the world."""
        total = torch.zeros(self.rays.share.shape[1], receivers, order * order)
        for row, column, share, direction in self.escaped():
            values = share * weights[column][:, None]
            for some in torch.arange(len(row)).split(max(1, _NUMBERS // order**2)):
                harmonics = basis(direction[some], order)
                for channel, value in zip(total, values[some].unbind(1), strict=True):
                    channel.index_add_(0, row[some], harmonics * value[:, None])
        return total.mT

    def radiance(self, order: int, receivers: int, directions: int) -> Float[Tensor, "v D W"]:
        """The same along each direction, not summed, over channels and coefficients of the light."""
        channels = self.rays.share.shape[1]
        found = torch.zeros(receivers, directions, channels * order * order)
        for row, column, share, direction in self.escaped():
            found[row, column] = (share[..., None] * basis(direction, order)[:, None]).flatten(1)
        return found

    def lost(self, weights: Float[Tensor, "D"], receivers: int) -> Float[Tensor, "v"]:
        """What was cut off of the light of each receiver, a share of what could arrive."""
        return torch.zeros(receivers).index_add_(0, self.row, self.rays.lost * weights[self.column])

    def shares(self, receivers: int, directions: int) -> Float[Tensor, "v D A"]:
        """What is left of the light along each ray."""
        found = torch.ones(receivers, directions, self.rays.share.shape[1])
        found[self.row, self.column] = self.rays.share
        return found

    def toward(self, directions: Float[Tensor, "v D 3"]) -> Float[Tensor, "v D 3"]:
        """The last leg of each ray in the world, given the first, in place."""
        directions[self.row, self.column] = self.rays.direction
        return directions


def by_way_of_mirrors(
    tracer: Tracer, mirrors: Mirrors, hits: Hits, turned: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
) -> ByMirrors:
    """What rays from receivers in the frames `turned` come to that met a mirror."""
    is_mirror = (hits.triangle >= 0) & (mirrors.number[hits.triangle.clamp(min=0).long()] >= 0)
    row, column = torch.nonzero(is_mirror, as_tuple=True)
    world = (directions[column][:, None] @ turned[row])[:, 0]
    rays = follow(tracer, mirrors, hits, row * len(directions) + column, world)
    ends = [part.clone() for part in (hits.triangle, hits.u, hits.v, hits.front)]
    for part, values in zip(ends, (rays.triangle, rays.u, rays.v, rays.front), strict=True):
        part[row, column] = values
    return ByMirrors(Hits(*ends), row, column, rays)


def mean_cut(cut: list[float]) -> float | None:
    """The mean over receivers; None where there are no mirrors. An exact sum: in whatever order they came."""
    return math.fsum(cut) / len(cut) if cut else None


def warn_of_cut(cut: float | None) -> None:
    """Warns if a share of the light that could arrive at the receivers was cut off."""
    if cut is not None and cut > CUT:
        warnings.warn(
            f"{cut:.2%} of the light that could arrive was still between mirrors after {REFLECTIONS} reflections and "
            "is left out: mirrors that close a room darken it, let light leave or give them a lower reflectance",
            MirrorWarning,
            stacklevel=4,
        )
