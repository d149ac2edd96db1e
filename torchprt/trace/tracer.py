"""Embree behind a few questions: what is visible, what is hit, what does a camera see, where does a ray go on to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.trace.engines import chosen
from torchprt.trace.engines import engine as engine_of
from torchprt.trace.hits import Hits
from torchprt.trace.rays import starts

# Rays start this far off their surface, relative to the coordinates that were rounded to float32 and to the triangles
# that meet there: 64 epsilon. Embree's own error on such a triangle is a few epsilon of the same lengths, the
# rounding of the origin half an epsilon.
OFFSET = 64 * 2.0**-23


@dataclass
class Spot:
    """Points of triangles in the frame of the tracer, float64: `place`, the `normal` of the face, the `smooth` one of
    its vertices, and the `extent [E]` of the triangle. A face without area has the normal zero."""

    place: Float[Tensor, "E 3"]
    normal: Float[Tensor, "E 3"]
    smooth: Float[Tensor, "E 3"]
    extent: Float[Tensor, "E"]

    def leave(self, away: Float[Tensor, "E 3"]) -> Float[Tensor, "E 3"]:
        """Where rays that leave toward the side `away` start, as `Tracer.origins`."""
        lift = OFFSET * (self.place.abs().amax(-1) + self.extent)
        return self.place + lift[:, None] * away


class Tracer:
    """Rays against the triangles of a scene.

    Positions are recentred in float64 and scaled by a power of two to unit size before they become float32, so that
    a scan in micrometres far from its origin is traced as exactly as one around it.
    Embree runs in robust mode: no ray slips through a shared edge. Thread-safe, without the GIL while it traces.
    Pickles as its geometry and the name of its `engine`, of those of `engines.py`; where that cannot run InputError is
    raised, because rays that meet a triangle at its very edge may end elsewhere with another.
    `few`: that few rays will be traced, by which an engine is chosen where none is given.
    Source of the offset: Waechter and Binder, Ray Tracing Gems 1, chapter 6.
    """

    def __init__(
        self,
        positions: Float[Tensor, "V 3"],
        faces: Int[Tensor, "F 3"],
        engine: str | None = None,
        *,
        few: bool = False,
    ):
        self.engine = engine or chosen(few)
        self._positions = positions.detach().to("cpu", torch.float64)
        self._faces = faces.detach().to("cpu", torch.int32).contiguous()
        if len(self._faces) == 0:
            raise InputError("the scene has no triangles to trace: give a mesh with faces")
        used = self._positions[self._faces.flatten().unique().long()]
        low, high = used.amin(0), used.amax(0)
        extent = float((high - low).max())
        if not np.isfinite(extent) or extent == 0:
            raise InputError("the scene has no extent: its triangles are all one point or not finite")
        self.centre = (low + high) / 2
        self.scale = 2.0 ** -np.ceil(np.log2(extent))
        self._build()

    def _build(self) -> None:
        vertices = self.local(self._positions).to(torch.float32).contiguous().numpy()
        self._embree = engine_of(self.engine)(vertices, self._faces.numpy())

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "_embree"}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._build()

    @property
    def at_once(self) -> int:
        """How many rays `visibility` answers fastest."""
        return self._embree.at_once

    def local(self, points: Float[Tensor, "*v 3"]) -> Float[Tensor, "*v 3"]:
        """World points in the recentred frame of unit size in which rays are traced, float64."""
        return (points.to(torch.float64) - self.centre) * self.scale

    def corners(self) -> Float[Tensor, "F 3 3"]:
        """The corners of all triangles in the world, float64."""
        return self._positions[self._faces.long()]

    def origins(
        self,
        points: Float[Tensor, "v 3"],
        away: Float[Tensor, "v 3"],
        size: Float[Tensor, "v"] | float = 0.0,
    ) -> Float[Tensor, "v 3"]:
        """Where rays from surface points start, float32, local frame: moved along `away` (the normal, or more) by
        `OFFSET` times the largest coordinate plus `size`, the extent of the triangles around each point in the world.
        """
        local = self.local(points)
        size = torch.as_tensor(size, dtype=torch.float64) * self.scale
        lift = OFFSET * (local.abs().amax(-1) + size)
        return (local + lift[:, None] * away.to(torch.float64)).to(torch.float32)

    def visibility(
        self,
        origins: Float[Tensor, "v *S 3"],
        frames: Float[Tensor, "v 3 3"],
        directions: Float[Tensor, "D 3"],
    ) -> Float32[Tensor, "v D"]:
        """1 where the ray escapes, 0 where anything blocks it.

        `origins` from `origins()`, one a receiver or S, [v, S, 3], of which every S-th ray has the same; `directions`
        in the local frames whose rows are tangent, bitangent and normal.
        """
        return self._embree.visibility(origins, frames, directions)

    def hits(
        self,
        origins: Float[Tensor, "v *S 3"],
        frames: Float[Tensor, "v 3 3"],
        directions: Float[Tensor, "D 3"],
    ) -> Hits:
        """The nearest hit of every ray; arguments as for `visibility`."""
        return self._embree.hits(origins, frames, directions)

    def distances(self, origins: Float[Tensor, "v *S 3"], hits: Hits) -> Float[Tensor, "v D"]:
        """How far the hits are from the `origins` of their rays, in the frame of the tracer; infinity where a ray
        escapes."""
        found = torch.full(hits.triangle.shape, torch.inf)
        row, column = torch.nonzero(hits.triangle >= 0, as_tuple=True)
        u, v = hits.u[row, column], hits.v[row, column]
        weights = torch.stack([1 - u - v, u, v], -1).double()
        corners = self.local(self._positions[self._faces[hits.triangle[row, column].long()].long()])
        start = starts(origins, found.shape[1])[row, column]
        away = (weights[..., None] * corners).sum(1) - start.double()
        found[row, column] = torch.linalg.vector_norm(away, dim=-1).to(torch.float32)
        return found

    def camera(self, eye: Float[Tensor, "3"], directions: Float[Tensor, "H W 3"]) -> Hits:
        """What a pinhole camera at `eye` (world) sees along each direction (world, any length)."""
        height, width = directions.shape[:2]
        rays = np.ascontiguousarray(directions.reshape(-1, 3).to(torch.float32).numpy())
        start = np.ascontiguousarray(self.local(eye).to(torch.float32).expand(height * width, 3).numpy())
        found = self._embree.nearest(start, rays)
        return Hits(*(part.view(height, width) for part in vars(found).values()))

    def onward(self, origins: Float[Tensor, "E 3"], directions: Float[Tensor, "E 3"]) -> Hits:
        """The nearest hit of single rays: `origins` of `Spot.leave`, `directions` in the world."""
        start, rays = (part.to(torch.float32).contiguous().numpy() for part in (origins, directions))
        return self._embree.nearest(start, rays)

    def surface(
        self,
        face: Int[Tensor, "E"],
        u: Float[Tensor, "E"],
        v: Float[Tensor, "E"],
        normals: Float[Tensor, "Vall 3"],
    ) -> Spot:
        """Where points of triangles are; `normals` of all vertices."""
        corners = self._faces[face].long()
        places = self.local(self._positions[corners])
        weights = torch.stack([1 - u - v, u, v], -1).double()[..., None]
        along, across = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
        normal = torch.nn.functional.normalize(torch.linalg.cross(along, across), dim=-1)
        smooth = (normals[corners].double() * weights).sum(1)
        length = torch.linalg.vector_norm(smooth, dim=-1, keepdim=True)
        smooth = torch.where(length > 1e-6, smooth / length.clamp(min=1e-6), normal)
        extent = (places.amax(1) - places.amin(1)).amax(-1)
        return Spot((places * weights).sum(1), normal, smooth, extent)
