"""Where the texels of a map are on the surfaces of a scene, and what these are made of there."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int64
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.brdf import Brdf
from torchprt.errors import InputError
from torchprt.words import count

from .charts import Charts, charts_of
from .energy import EnergyWarning
from .finish import Finish
from .geometry import Geometry, distinct
from .glosses import Glosses
from .lightmap import Lightmap
from .object import Object
from .points import Points
from .rasterise import Raster, rasterise, with_seams
from .scene import Scene
from .seams import Seams, seams
from .tangents import orthogonal

# Samples of texels that are looked at together.
BLOCK = 1 << 20


@dataclass(frozen=True, eq=False)
class TexelSamples:
    """The V texels of a map with S samples each, on the surfaces of a scene.

    - `points`: what each records: positions and unit normals in the mean of its samples, the means of albedo and
      specular, the gloss of its first sample.
    - `origins [V, S, 3]`: where rays start, before they are lifted off the surface: samples, moved out to where a
      smooth surface through the vertices with their normals would be, so that a facet does not shade itself.
    - `extent [V]`: that of the largest of the faces that its samples lie in.
    - `chart [V]`; of all faces of the scene `chart_of_face [F]`, and `uv [F, 3, 2]`, NaN where they record nothing.
    - `seams`: where surfaces go on beyond the borders of charts, in texels.
    - `notes`: what was decided and mended, in sentences.
    Source of the move: Hanika, Ray Tracing Gems 2 (2021), chapter 4, Hacking the Shadow Terminator.
    """

    lightmap: Lightmap
    points: Points
    raster: Raster
    origins: Float64[Tensor, "V S 3"]
    extent: Float64[Tensor, "V"]
    chart: Int64[Tensor, "V"]
    chart_of_face: Int64[Tensor, "F"]
    uv: Float64[Tensor, "F 3 2"]
    seams: Seams
    notes: tuple[str, ...]


def texel_samples(scene: Scene, geometry: Geometry, lightmap: Lightmap) -> TexelSamples:
    """The texels of a map of a scene.

    Raises InputError as `charts_of`, if there is no texel on any surface, or if a surface is of a kind that is recorded
    at vertices alone: translucent, or a body that light diffuses in.
    """
    objects = scene.objects
    for each in objects:
        if each.receives and (each.material.translucency or each.material.medium is not None):
            kind = "translucent" if each.material.translucency else "a medium that light diffuses in"
            raise InputError(
                f"{each.mesh.name} is {kind}, which is recorded at vertices: bake it without texels, and take the "
                "result to texels with transfer.to_texels"
            )
    charts = charts_of(objects, lightmap.uv, lightmap.rows, lightmap.columns, lightmap.gutter)
    uv, chart = _of_all(objects, charts)
    raster = rasterise(uv, chart, lightmap.rows, lightmap.columns, lightmap.across)
    if not len(raster.texel):
        raise InputError("the texture coordinates of the scene put nothing on the map: use --uv unwrap")
    notes = [*charts.notes, *_notes(objects, raster, uv, chart)]
    size = np.array([lightmap.columns, lightmap.rows])
    normals = np.concatenate([each.mesh.normals.numpy()[each.mesh.faces.numpy()] for each in objects])
    beyond = seams(geometry.positions.numpy(), geometry.faces.numpy(), normals, uv * size, lightmap.gutter + 1.0)
    number = geometry.face_object.numpy()
    beyond = beyond.take(number[beyond.face] == number[beyond.other])
    # Samples beyond a seam are of another chart.
    chart_of_texel = chart[raster.face[:, 0]]
    raster = with_seams(raster, beyond, uv, chart, lightmap.rows, lightmap.columns, lightmap.across)
    samples = _Samples(objects, raster, uv * size)
    return TexelSamples(
        lightmap,
        samples.points(),
        raster,
        samples.origins,
        samples.extent,
        torch.from_numpy(chart_of_texel),
        torch.from_numpy(chart),
        torch.from_numpy(uv),
        beyond,
        (*notes, *samples.notes),
    )


def _of_all(objects: Sequence[Object], charts: Charts) -> tuple[np.ndarray, np.ndarray]:
    """Texture coordinates and charts of all faces of a scene."""
    uv, number, first = [], [], 0
    for each, own, pieces in zip(objects, charts.uv, charts.chart, strict=True):
        uv.append(own.numpy() if each.receives else np.full((len(each.mesh.faces), 3, 2), np.nan))
        number.append(pieces.numpy() + first)
        first += int(pieces.max()) + 1
    return np.concatenate(uv), np.concatenate(number)


def _notes(objects: Sequence[Object], raster: Raster, uv: np.ndarray, chart: np.ndarray) -> list[str]:
    notes = []
    if raster.lost.any():
        notes.append(
            f"{count(int(raster.lost.sum()), 'face')} of the map have no texel of their own and show what their "
            "neighbours do"
        )
    seen = np.unique(chart[raster.face[raster.own.any(axis=1), 0]])
    small = len(np.setdiff1d(chart[np.isfinite(uv).all(axis=(1, 2))], seen))
    if small:
        notes.append(f"{count(small, 'chart')} smaller than a texel: sampled at the point nearest to its middle")
    if raster.twice:
        notes.append(f"{count(raster.twice, 'texel')} with several faces at one place, of which the first shows")
    both = [each.mesh.name for each in objects if each.receives and bool(each.two_sided.any())]
    if both:
        notes.append(f"{', '.join(both)}: texels are of one side, the other is black")
    return notes


class _Samples:
    """What is at the samples of all texels, object by object."""

    def __init__(self, objects: Sequence[Object], raster: Raster, corners: np.ndarray):
        """`corners [F, 3, 2]`: of all faces, in texels of the map."""
        self.notes: list[str] = []
        texels, per = raster.face.shape
        self.positions = torch.zeros(texels, 3, dtype=torch.float64)
        self.normals, self.tangents = torch.zeros_like(self.positions), torch.zeros_like(self.positions)
        self.origins = torch.zeros(texels, per, 3, dtype=torch.float64)
        self.extent = torch.zeros(texels, dtype=torch.float64)
        self.albedo, self.specular = torch.zeros(texels, 3), torch.zeros(texels, 3)
        self.gloss = torch.full((texels,), -1)
        self.models = distinct([brdf for each in objects if each.glossy for brdf in each.material.glosses])
        starts = [0, *itertools.accumulate(len(each.mesh.faces) for each in objects)]
        of_texel = np.searchsorted(starts, raster.face[:, 0], side="right") - 1
        for number, each in enumerate(objects):
            mine = np.flatnonzero(of_texel == number)
            if not len(mine):
                continue
            finish = Finish(each)
            pitch = _pitch(each, corners[starts[number] : starts[number + 1]]) / per**0.5
            for some in np.array_split(mine, len(mine) * per // BLOCK + 1):
                if len(some):
                    face = torch.from_numpy(raster.face[some].astype(np.int64) - starts[number])
                    weights = torch.from_numpy(raster.weights[some])
                    self._fill(finish, torch.from_numpy(some), face, weights, pitch[face])
            self.notes += finish.notes

    def _fill(self, finish: Finish, rows: Tensor, face: Tensor, weights: Tensor, side: Tensor) -> None:
        """The texels `rows` of one object: `face [v, S]` of its own, `weights [v, S, 3]` of their corners, and how long
        a side of what each stands for is on the surface."""
        object = finish.object
        mesh, shape = object.mesh, face.shape
        # They must sum to 1 exactly, or a mesh far from the origin leaves its own planes.
        second, third = weights[..., 1].double(), weights[..., 2].double()
        weights = torch.stack([1 - second - third, second, third], -1)
        corners = mesh.positions[mesh.faces[face]]
        places = (corners * weights[..., None]).sum(-2)
        flat, shares = face.flatten(), weights.flatten(0, 1)
        normals = finish.normals(flat, shares, side.flatten()).unflatten(0, shape)
        self.positions[rows] = places.mean(1)
        self.normals[rows] = _mean_direction(normals)
        self.origins[rows] = _smoothed(places, corners, mesh.normals[mesh.faces[face]], weights)
        self.extent[rows] = (corners.amax(-2) - corners.amin(-2)).amax((-1, -2))
        made = finish.reflecting(face, weights, side)
        self.albedo[rows] = made.albedo.expand(-1, 3)
        if object.glossy:
            self.specular[rows] = made.specular.expand(-1, 3)
            own, gloss = self._numbers(object.material.glosses), made.gloss
            self.gloss[rows] = torch.where(gloss >= 0, own[gloss.clamp(min=0)], -1)
            along = (mesh.tangent_field[mesh.faces[face]] * weights[..., None]).sum((-2, -3))
            turned = orthogonal(along.numpy(), self.normals[rows].numpy())
            self.tangents[rows] = torch.from_numpy(turned)

    def _numbers(self, glosses: Sequence[Brdf]) -> Int64[Tensor, "models"]:
        """The numbers of the glosses of an object among those of the scene."""
        return torch.tensor([self._number(each) for each in glosses])

    def _number(self, brdf: Brdf) -> int:
        return next(at for at in range(len(self.models)) if len(distinct([self.models[at], brdf])) == 1)

    def points(self) -> Points:
        """All texels as receivers."""
        glosses = Glosses(self.models, self.gloss) if self.models and bool((self.gloss >= 0).any()) else None
        with warnings.catch_warnings():
            # What is to be said of the energy has been said of the materials.
            warnings.simplefilter("ignore", EnergyWarning)
            return Points(
                self.positions,
                self.normals,
                albedo=_narrow(self.albedo),
                gloss=glosses,
                specular=1.0 if glosses is None else _narrow(self.specular),
                tangents=self.tangents,
            )


def _pitch(object: Object, corners: Float64[np.ndarray, "F 3 2"]) -> Float64[Tensor, "F"]:
    """How long a side of a texel is on each face of a surface; `corners`: in texels."""
    places = object.mesh.positions.numpy()[object.mesh.faces.numpy()]
    one, other = places[:, 1] - places[:, 0], places[:, 2] - places[:, 0]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    texels = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    area = np.linalg.norm(np.cross(one, other), axis=1)
    # Of a face without area on the map nothing is known.
    side = np.sqrt(np.divide(area, texels, out=np.zeros_like(area), where=texels > 0))
    return torch.from_numpy(side)


def _narrow(values: Float32[Tensor, "V 3"]) -> Float32[Tensor, "V C"]:
    """One channel if all three are alike."""
    return values if bool((values != values[:, :1]).any()) else values[:, :1]


def _mean_direction(normals: Float64[Tensor, "v S 3"]) -> Float64[Tensor, "v 3"]:
    """The unit mean of some normals; where they cancel the first."""
    mean = normals.mean(1)
    return torch.where(mean.norm(dim=-1, keepdim=True) > 1e-6, normalize(mean, dim=-1), normals[:, 0])


def _smoothed(
    places: Float64[Tensor, "v S 3"],
    corners: Float64[Tensor, "v S 3 3"],
    normals: Float64[Tensor, "v S 3 3"],
    weights: Float64[Tensor, "v S 3"],
) -> Float64[Tensor, "v S 3"]:
    """Places of faces moved out to where a surface with the normals of the corners would be; never inward."""
    below = ((places[..., None, :] - corners) * normals).sum(-1).clamp(max=0)
    return places - (below[..., None] * normals * weights[..., None]).sum(-2)
