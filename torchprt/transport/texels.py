"""Transfer at the texels of a map: they take the place of vertices, as what records and as what reflects."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix, csr_matrix
from torch import Tensor

from torchprt.memory import check_memory
from torchprt.scene import Geometry, Lightmap, Scene
from torchprt.scene.gutters import gutters
from torchprt.scene.texel_samples import TexelSamples, texel_samples
from torchprt.trace import Tracer
from torchprt.transfer import Atlas, Sight
from torchprt.transport.bounce import Surfaces
from torchprt.transport.directions import hemisphere
from torchprt.transport.mirrors import mirrors_of
from torchprt.transport.points import among
from torchprt.transport.receivers import Receivers
from torchprt.transport.result import single
from torchprt.transport.through_volume import ThroughVolume
from torchprt.transport.validity import Validity, along
from torchprt.transport.views import BURIED, COVERED, pieces

# Rays of a sample that is looked at, and of one that looks odd.
GLANCE, LOOK = 8, 64


@dataclass
class TexelSurfaces(Surfaces):
    """Surfaces whose exit radiance is that of the texel at each point, and not of the corners around it.

    `receiver [rows, columns]`: of the texels, -1 where there is none; `uv [F, 3, 2]`: where the corners of faces are on
    the map, in texels."""

    receiver: Int[Tensor, "rows columns"] | None = None
    uv: Float[Tensor, "F 3 2"] | None = None

    def senders(
        self, triangle: Int[Tensor, "E"], u: Float[Tensor, "E"], v: Float[Tensor, "E"], front: Bool[Tensor, "E"]
    ) -> tuple[Int[Tensor, "E 1"], Float[Tensor, "E 1"]]:
        assert self.receiver is not None
        assert self.uv is not None
        corners = self.uv[triangle]
        place = (
            corners[:, 0] + u[:, None] * (corners[:, 1] - corners[:, 0]) + v[:, None] * (corners[:, 2] - corners[:, 0])
        )
        rows, columns = self.receiver.shape
        column = place[:, 0].nan_to_num(0).floor().clamp(0, columns - 1).long()
        row = place[:, 1].nan_to_num(0).floor().clamp(0, rows - 1).long()
        found = torch.where(front & (self.front[triangle, 0] >= 0), self.receiver[row, column].long(), -1)
        return found[:, None], torch.ones(len(found), 1)

    def contents(self) -> list[Tensor]:
        return [each for each in (self.receiver, self.uv) if each is not None]


@dataclass(frozen=True, eq=False)
class Lightmapped:
    """A scene that is recorded at the texels of a map: their samples, the scene itself, and it with texels for its
    receivers."""

    samples: TexelSamples
    scene: Geometry
    geometry: Geometry

    def surfaces(self, volume: ThroughVolume | None) -> TexelSurfaces:
        """What is hit of the scene, in texels."""
        lightmap, raster = self.samples.lightmap, self.samples.raster
        number = torch.full((lightmap.rows * lightmap.columns,), -1, dtype=torch.int32)
        number[torch.from_numpy(raster.texel)] = torch.arange(len(raster.texel), dtype=torch.int32)
        uv = (self.samples.uv * self.samples.uv.new_tensor([lightmap.columns, lightmap.rows])).float()
        front = torch.where(uv.isfinite().all(-1), 0, -1)
        back = torch.full_like(front, -1)
        table = number.view(lightmap.rows, lightmap.columns)
        return TexelSurfaces(front, back, mirrors_of(self.scene), volume, table, uv)

    def receivers(self, tracer: Tracer) -> Receivers:
        """Texels with the origins of their rays, one a sample."""
        points, normals = self.geometry.receiver_positions, self.geometry.receiver_normals
        samples = self.samples.origins
        count = samples.shape[1]
        away, size = normals.repeat_interleave(count, 0), self.samples.extent.repeat_interleave(count)
        origins = tracer.origins(samples.flatten(0, 1), away, size).unflatten(0, (-1, count))
        return Receivers(points, normals, origins)

    def atlas(self, validity: Validity | None) -> Atlas:
        """As what a transfer is recorded at, and drawn on."""
        samples, scene = self.samples, self.scene
        lightmap, texel = samples.lightmap, samples.raster.texel
        recording = scene.receiver_of_vertex[scene.faces]
        shown = (recording >= 0).all(-1)
        of_vertex = torch.nonzero(scene.receiver_of_vertex >= 0)[:, 0]
        positions, normals = scene.receiver_positions[: len(of_vertex)], scene.receiver_normals[: len(of_vertex)]
        faces, uv = recording[shown], samples.uv[shown]
        found = gutters(
            texel,
            samples.chart.numpy(),
            lightmap.rows,
            lightmap.columns,
            lightmap.gutter,
            samples.seams,
            samples.chart_of_face.numpy(),
        )
        _, chart = samples.chart.unique(return_inverse=True)
        sight = None if validity is None or not bool(validity.sight.any()) else validity.sight
        return Atlas(
            rows=lightmap.rows,
            columns=lightmap.columns,
            positions=single(self.geometry.receiver_positions),
            normals=self.geometry.receiver_normals.float(),
            texel=torch.from_numpy(texel).to(torch.int32),
            chart=chart.to(torch.int32),
            mesh_positions=single(positions),
            mesh_normals=normals.float(),
            mesh_faces=faces.to(torch.int32),
            mesh_uv=uv.float(),
            gutter=torch.from_numpy(found.texel).to(torch.int32),
            gutter_sources=torch.from_numpy(found.sources).to(torch.int32),
            gutter_weights=torch.from_numpy(found.weights).float(),
            sight=sight,
            objects=self._objects(shown),
            notes=samples.notes,
        )

    def _objects(self, shown: Bool[Tensor, "F"]) -> list[dict[str, Any]]:
        scene = self.scene
        before = [0, *shown.long().cumsum(0).tolist()]
        of_face, covered = scene.face_object, self.samples.chart.unique()
        found = []
        for number, (name, role, rows) in enumerate(zip(scene.names, scene.roles, scene.slices, strict=True)):
            if rows.stop > rows.start:
                mine = torch.nonzero(of_face == number)[:, 0]
                first, last = int(mine[0]), int(mine[-1]) + 1
                faces = [before[first], before[last]]
                # Charts ascend with the objects.
                own = self.samples.chart_of_face[mine]
                charts = torch.searchsorted(covered, torch.stack([own.min(), own.max() + 1])).tolist()
                vertices = [rows.start, rows.stop]
                found.append({"name": name, "role": role, "vertices": vertices, "faces": faces, "charts": charts})
        return found


def lightmapped(scene: Scene, geometry: Geometry, lightmap: Lightmap, numbers: int) -> Lightmapped:
    """The texels of a map as the receivers of a scene. `numbers`: float32 numbers that a bake holds of each.

    Raises InputError as `texel_samples`, or if they need more memory than there is, before anything is traced."""
    size = lightmap.rows * lightmap.columns
    instead = "give fewer texels, a lower order or fewer bounces"
    what = f"a map of {lightmap.columns} x {lightmap.rows} texels"
    check_memory(_MAP * lightmap.samples * size, what, instead)
    samples = texel_samples(scene, geometry, lightmap)
    count = len(samples.raster.texel)
    check_memory(
        count * (4 * numbers + _TEXEL + _SAMPLE * lightmap.samples), f"{what}, {count} of them covered,", instead
    )
    recorded = among(samples.points, geometry)
    # Mirrors stay: light that meets them goes on, and what cannot be recorded with them is refused.
    recorded = dataclasses.replace(recorded, mirror=geometry.mirror, reflectance=geometry.reflectance)
    return Lightmapped(samples, geometry, recorded)


# Bytes of a sample of a map while it is rasterised, of a texel, and of one of its samples, as measured.
_MAP, _TEXEL, _SAMPLE = 42, 700, 160


def with_sight(texels: Lightmapped, tracer: Tracer, receivers: Receivers) -> tuple[Receivers, Validity]:
    """Texels whose samples lie in a solid take their other samples instead; those that have none are filled from their
    neighbours on the map.

    A sample cannot see if half of its rays or more end on the back of a closed surface (it is buried), or nearly all
    within rounding of where they start (another face lies on it).
    """
    buried = _buried(texels, tracer, receivers)
    count = buried.shape[1]
    ranked = buried.to(torch.uint8).argsort(dim=1, stable=True)
    seeing = (~buried).sum(1)
    place = torch.arange(count)
    instead = ranked.gather(1, place[None] % seeing.clamp(min=1)[:, None])
    chosen = torch.where(buried, instead, place)
    origins = receivers.origins.gather(1, chosen[..., None].expand(-1, -1, 3))
    sight = torch.zeros(len(receivers), dtype=torch.uint8)
    sight[(seeing > 0) & (seeing < count)] = int(Sight.MOVED)
    sight[seeing == 0] = int(Sight.FILLED)
    sight[(receivers.normals == 0).all(-1)] = int(Sight.FILLED)
    return dataclasses.replace(receivers, origins=origins), along(_links(texels.samples), sight)


def _buried(texels: Lightmapped, tracer: Tracer, receivers: Receivers) -> Bool[Tensor, "V S"]:
    piece, closed = pieces(texels.scene)
    inside = closed[piece]
    count = receivers.origins.shape[1]
    found = torch.zeros(len(receivers), count, dtype=torch.bool)
    for at in range(count):
        alone = dataclasses.replace(receivers, origins=receivers.origins[:, at])
        odd, near = _views(alone, tracer, inside, GLANCE)
        doubtful = torch.nonzero((odd > 0) | (near > 0.5))[:, 0]
        odd, near = _views(alone[doubtful], tracer, inside, LOOK)
        found[doubtful, at] = (odd >= BURIED) | (near >= COVERED)
    return found


def _views(
    receivers: Receivers, tracer: Tracer, inside: Bool[Tensor, "F"], rays: int
) -> tuple[Float[Tensor, "v"], Float[Tensor, "v"]]:
    """The shares of rays that end on the back of a closed surface, and within rounding of where they start."""
    directions, turned = hemisphere(rays).float(), receivers.frames()
    odd, near = torch.zeros(len(receivers)), torch.zeros(len(receivers))
    start = tracer.local(receivers.points)
    for rows in receivers.blocks(rays):
        hits = tracer.hits(receivers.origins[rows], turned[rows], directions)
        back = (hits.triangle >= 0) & ~hits.front & inside[hits.triangle.clamp(min=0).long()]
        odd[rows] = back.float().mean(1)
        lift = 4 * 64 * 2.0**-23 * start[rows].abs().amax(-1).clamp(min=2.0**-10)
        near[rows] = (tracer.distances(receivers.origins[rows], hits) <= lift[:, None]).float().mean(1)
    return odd, near


def _links(samples: TexelSamples) -> csr_matrix:
    """Which texels of one chart lie beside each other on the map."""
    rows, columns = samples.lightmap.rows, samples.lightmap.columns
    texel, chart = samples.raster.texel, samples.chart.numpy()
    number = np.full((rows + 1, columns + 1), -1)
    number[texel // columns, texel % columns] = np.arange(len(texel))
    one = np.concatenate([number[:-1].ravel(), number[:, :-1].ravel()])
    other = np.concatenate([number[1:].ravel(), number[:, 1:].ravel()])
    both = (one >= 0) & (other >= 0)
    one, other = one[both], other[both]
    alike = chart[one] == chart[other]
    one, other = one[alike], other[alike]
    ends = np.concatenate([one, other]), np.concatenate([other, one])
    return coo_matrix((np.ones(len(ends[0])), ends), (len(texel), len(texel))).tocsr()
