"""Mirrors: rays that meet one are reflected and followed to a surface that is none, or out of the scene."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.trace.hits import Hits
from torchprt.trace.tracer import Tracer

# Reflections from mirror to mirror after which what is left of the light of a ray is cut off, and said.
REFLECTIONS = 32


@dataclass(frozen=True, eq=False)
class Mirrors:
    """Which faces are mirrors, and what they reflect; both sides do.

    - `number [F]`: which mirror each face is of, -1 for none.
    - `reflectance [K, C]`: of each mirror, along its normal; at other angles it rises to 1 (Schlick's approximation of
      Fresnel's formula for a metal). C = 1 or 3.
    - `normals [Vall, 3]`: of the vertices, float64: a mirror is as smooth as they are. Zero: the face counts.
    """

    number: Int[Tensor, "F"]
    reflectance: Float[Tensor, "K C"]
    normals: Float[Tensor, "Vall 3"]

    @property
    def channels(self) -> int:
        return self.reflectance.shape[1]


@dataclass(frozen=True, eq=False)
class Reflected:
    """Rays that met a mirror: their `ray [E]` among all, ascending, and where each of them came to.

    `direction [E, 3]`: of the last leg, in the world. `share [E, C]`: what is left of the light that comes along it,
    float32. `triangle [E]` with `u`, `v` and `front`: the surface it ends on, -1 if it leaves the scene; a ray that is
    still among mirrors after all reflections ends on one, and `lost [E]` is the mean share that is cut off with it.
    """

    ray: Int[Tensor, "E"]
    direction: Float[Tensor, "E 3"]
    share: Float[Tensor, "E C"]
    triangle: Int[Tensor, "E"]
    u: Float[Tensor, "E"]
    v: Float[Tensor, "E"]
    front: Tensor
    lost: Float[Tensor, "E"]


def follow(
    tracer: Tracer,
    mirrors: Mirrors,
    hits: Hits,
    ray: Int[Tensor, "E"],
    directions: Float[Tensor, "E 3"],
    reflections: int = REFLECTIONS,
) -> Reflected:
    """Where the rays `ray` of `hits`, all of which end on mirrors, come to; `directions` in the world.

    Source: Sloan, Kautz and Snyder 2002, section 5 (mirror-like surfaces); Schlick 1994, equation 15, for the
    reflectance.
    """
    flat = [part.flatten()[ray] for part in (hits.triangle, hits.u, hits.v, hits.front)]
    triangle, u, v, front = (part.clone() for part in flat)
    direction = normalize(directions.double(), dim=-1)
    share = torch.ones(len(ray), mirrors.channels, dtype=torch.float64)
    reflectance = mirrors.reflectance.double()
    for _ in range(reflections):
        among = torch.nonzero((triangle >= 0) & (mirrors.number[triangle.long()] >= 0))[:, 0]
        if not len(among):
            break
        face = triangle[among].long()
        spot = tracer.surface(face, u[among], v[among], mirrors.normals)
        reflected, cosine = _mirrored(direction[among], spot.normal, spot.smooth)
        base = reflectance[mirrors.number[face].long()]
        share[among] *= base + (1 - base) * (1 - cosine[:, None]) ** 5
        direction[among] = reflected
        away = torch.where((reflected * spot.normal).sum(-1, keepdim=True) < 0, -spot.normal, spot.normal)
        found = tracer.onward(spot.leave(away), reflected)
        triangle[among], u[among], v[among], front[among] = found.triangle, found.u, found.v, found.front
    left = (triangle >= 0) & (mirrors.number[triangle.long()] >= 0)
    lost = torch.where(left, share.mean(-1), 0)
    return Reflected(ray, direction.float(), share.float(), triangle, u, v, front, lost.float())


def _mirrored(
    direction: Float[Tensor, "E 3"], normal: Float[Tensor, "E 3"], smooth: Float[Tensor, "E 3"]
) -> tuple[Float[Tensor, "E 3"], Float[Tensor, "E"]]:
    """Directions reflected about smooth normals, and the cosine of the angle of incidence.

    Where that would lead into the surface, or the smooth normal looks away, the face itself is the mirror."""
    toward = torch.where((direction * normal).sum(-1, keepdim=True) > 0, -normal, normal)
    bent = torch.where((smooth * toward).sum(-1, keepdim=True) < 0, -smooth, smooth)
    cosine = -(direction * bent).sum(-1, keepdim=True)
    reflected = direction + 2 * cosine * bent
    plain = -(direction * toward).sum(-1, keepdim=True)
    wrong = (cosine <= 0) | ((reflected * toward).sum(-1, keepdim=True) <= 0)
    reflected = torch.where(wrong, direction + 2 * plain * toward, reflected)
    return normalize(reflected, dim=-1), torch.where(wrong, plain, cosine)[:, 0].clamp(0, 1)
