"""What surfaces are made of at points of their faces: by the pictures of their files, else between vertices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int64
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.errors import InputError

from .detail import Detail
from .energy import reflected
from .glosses import Glosses
from .normal_map import TangentSpace, mapped_normals, tangent_space
from .object import Object
from .paint import NONE
from .surface import WIDTH, Opened, Painted, opened

# A gloss whose reflectance is too low loses light, one whose reflectance is too high is weighed down.
TOO_LOW, TOO_HIGH = 10.0, 0.1
# More times than that no picture is made smaller by two.
MOST = 64


class Reflecting(NamedTuple):
    """How V points reflect: albedo, weight of the gloss, and which of the glosses of the material, -1 for none."""

    albedo: Float32[Tensor, "V C"]
    specular: Float32[Tensor, "V C"]
    gloss: Int64[Tensor, "V"]


class Finish:
    """What an object is made of at points of its faces.

    What its material took from a file is looked up in the pictures of that, linear and made smaller to what a point
    stands for; all else is linear between the vertices of a face. Pictures are opened when they are first asked for,
    and are in memory as long as this is. `notes` say what could not be taken, in sentences.

    Raises InputError if the faces of the object are others than those of the file.
    """

    def __init__(self, object: Object):
        self.object = object
        self.notes: list[str] = []
        self._detail = object.material.detail if object.receives else None
        self._painted: dict[int, Painted] = {}
        self._bumps: dict[int, _Bumps | None] = {}
        surface = None if self._detail is None else self._detail.surface
        if surface is not None and not torch.equal(surface.mesh.faces, object.mesh.faces):
            raise InputError(
                f"{object.mesh.name} has other faces than the file that its material is of: load the mesh with its "
                "material again"
            )
        material = object.material
        self._colours = self._detail is not None and self._detail.albedo is material.albedo
        self._shines = (
            self._detail is not None
            and self._detail.glosses is not None
            and self._detail.glosses is material.gloss
            and self._detail.specular is material.specular
        )

    def reflecting(
        self,
        face: Int64[Tensor, "V S"],
        weights: Float[Tensor, "V S 3"],
        side: Float[Tensor, "V S"] | None = None,
    ) -> Reflecting:
        """How points reflect, each of S samples: the mean of these, and the gloss that is nearest to it.

        `face` and `weights` (of the three corners) are where samples are; `side` is how long a side of the square that
        each stands for is, in the unit of the mesh, 0 if it is not given.
        """
        albedo, specular, gloss = self._between(face, weights)
        if self._detail is not None and (self._colours or self._shines):
            made = _made(self._detail, self._look(self._detail, face, weights, side))
            if self._colours:
                albedo = made.albedo
            if self._shines:
                specular, gloss = made.specular, made.gloss
        return Reflecting(albedo, specular, gloss)

    def normals(
        self,
        face: Int64[Tensor, "E"],
        weights: Float[Tensor, "E 3"],
        side: Float[Tensor, "E"] | None = None,
    ) -> Float64[Tensor, "E 3"]:
        """Unit normals, with the normal map of the file; zero where those of the corners cancel or are missing."""
        mesh = self.object.mesh
        plain = normalize((mesh.normals[mesh.faces[face]] * weights[..., None]).sum(1), dim=-1)
        if self._detail is None:
            return plain
        surface = self._detail.surface
        for number, some in _by_paint(surface.paint_of_face, face):
            bumps = self._bumps_of(number)
            if bumps is not None:
                here = None if side is None else side[some]
                plain[some] = bumps.turned(plain[some], face[some], weights[some], here)
        return plain

    def _between(self, face: Tensor, weights: Tensor) -> Reflecting:
        object = self.object
        corners = object.mesh.faces[face]

        def mean(values: Float32[Tensor, "P C"]) -> Float32[Tensor, "V C"]:
            return (values[corners] * weights[..., None].to(values.dtype)).sum(2).mean(1)

        nearest = corners[:, 0].gather(1, weights[:, 0].argmax(1, keepdim=True))[:, 0]
        return Reflecting(mean(object.albedo), mean(object.specular), object.gloss_of_vertex[nearest])

    def _look(self, detail: Detail, face: Tensor, weights: Tensor, side: Tensor | None) -> Float32[Tensor, "11 V"]:
        """The means over samples of what the file says of each."""
        surface, flat = detail.surface, face.flatten()
        looks = torch.zeros(WIDTH, len(flat))
        for number, some in _by_paint(surface.paint_of_face, flat):
            painted = self._painted_of(detail, number)
            shares = weights.flatten(0, 1)[some].float()
            rows = torch.from_numpy(
                np.searchsorted(np.flatnonzero(surface.paint_of_face == number), flat[some].numpy())
            )
            wide = None if side is None else side.flatten()[some]
            looks[:, some] = _looked(painted, self._areas(flat[some]), rows, shares, wide)
        if surface.raw.tint is not None:
            tint = torch.from_numpy(np.asarray(surface.raw.tint)).float()[self.object.mesh.faces[flat]]
            looks[:6] *= (tint * weights.flatten(0, 1)[..., None].float()).sum(1).T.repeat(2, 1)
        total = looks.unflatten(1, face.shape).mean(2)
        return total / total[-1:]

    def _painted_of(self, detail: Detail, number: int) -> Painted:
        if number not in self._painted:
            surface = detail.surface
            paint = surface.paints[number] if surface.paints else NONE
            found = Painted(paint, surface.raw, np.flatnonzero(surface.paint_of_face == number), detail.gloss)
            self._painted[number] = found
        return self._painted[number]

    def _bumps_of(self, number: int) -> _Bumps | None:
        assert self._detail is not None
        surface = self._detail.surface
        if number not in self._bumps and surface.paints:
            paint, some = surface.paints[number], np.flatnonzero(surface.paint_of_face == number)
            picture = opened(paint, paint.normal_map, surface.raw, some, self.notes)
            self._bumps[number] = None if picture is None else _Bumps(self, picture, some, paint.normal_scale)
        return self._bumps.get(number)

    def space(self, picture: Opened, some: Int64[np.ndarray, "f"]) -> TangentSpace:
        """The tangent space of the faces `some` under a picture."""
        assert self._detail is not None
        mesh, raw = self.object.mesh, self._detail.surface.raw
        arrays = mesh.positions.numpy(), mesh.faces.numpy()[some], mesh.normals.numpy()
        own = None if mesh.tangents is None else mesh.tangents.numpy()
        return tangent_space(*arrays, picture.uv, own, raw.handed)

    def _areas(self, face: Int64[Tensor, "E"]) -> Float32[Tensor, "E"]:
        a, b, c = self.object.mesh.positions[self.object.mesh.faces[face]].unbind(1)
        return torch.linalg.cross(b - a, c - a).norm(dim=-1).float()


class _Bumps:
    """A normal map on some faces of an object."""

    def __init__(self, finish: Finish, picture: Opened, some: Int64[np.ndarray, "f"], scale: float):
        self._picture, self._some, self._scale, self._finish = picture, some, scale, finish
        space = finish.space(picture, some)
        self._tangents, self._handed = torch.from_numpy(space.tangents), torch.from_numpy(space.handed)

    def turned(
        self,
        normals: Float64[Tensor, "E 3"],
        face: Int64[Tensor, "E"],
        weights: Float[Tensor, "E 3"],
        side: Float[Tensor, "E"] | None,
    ) -> Float64[Tensor, "E 3"]:
        """Normals as the map turns them."""
        rows = torch.from_numpy(np.searchsorted(self._some, face.numpy()))
        colours = torch.zeros(3, len(face))
        level = _levels(self._picture, self._finish._areas(face), rows, side)
        for number in level.unique().tolist():
            here = level == number
            colours[:, here] = self._picture.texture.at(_places(self._picture, rows[here], weights[here]), number)[:3]
        along = (self._tangents[rows] * weights[..., None]).sum(1)
        return mapped_normals(normals, along, self._handed[rows], colours.T, self._scale)


def _by_paint(
    paint_of_face: Int64[np.ndarray, "F"], face: Int64[Tensor, "E"]
) -> list[tuple[int, Int64[Tensor, "some"]]]:
    """The materials of some faces, and which of these have each."""
    own = torch.from_numpy(np.asarray(paint_of_face, np.int64))[face]
    return [(number, (own == number).nonzero()[:, 0]) for number in own.unique().tolist()]


def _places(picture: Opened, rows: Int64[Tensor, "E"], weights: Float[Tensor, "E 3"]) -> Float32[Tensor, "E 2"]:
    """Where points are in a picture."""
    return (picture.corners[rows] * weights[..., None].float()).sum(1)


def _levels(
    picture: Opened, areas: Float32[Tensor, "E"], rows: Int64[Tensor, "E"], side: Float[Tensor, "E"] | None
) -> Int64[Tensor, "E"]:
    """How many times a picture is made smaller by two, so that one texel of it is about as wide as a point stands for.

    `areas` are twice those of the faces, on the surface."""
    if side is None:
        return torch.zeros(len(rows), dtype=torch.int64)
    corners = (torch.from_numpy(picture.uv) * torch.tensor(picture.texture.size))[rows]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    texels = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]).abs()
    across = side * (texels / areas.clamp(min=1e-30)).sqrt()
    most = int(np.ceil(np.log2(max(picture.texture.size))))
    return across.clamp(min=1.0).log2().round().clamp(max=most).long()


def _looked(
    painted: Painted,
    areas: Float32[Tensor, "E"],
    rows: Int64[Tensor, "E"],
    weights: Float32[Tensor, "E 3"],
    side: Float[Tensor, "E"] | None,
) -> Float32[Tensor, "11 E"]:
    """What a material says at points of its faces `rows`."""
    if not painted.maps:
        return painted.at([], (), 1).expand(-1, len(rows))
    levels = [_levels(each, areas, rows, side) for each in painted.maps]
    # Two pictures at most: one number for both.
    kind = levels[0] * MOST + levels[-1]
    found = torch.zeros(WIDTH, len(rows))
    for number in kind.unique().tolist():
        here = (kind == number).nonzero()[:, 0]
        uv = [_places(each, rows[here], weights[here]) for each in painted.maps]
        chosen = (number // MOST, number % MOST)[-len(levels) :]
        found[:, here] = painted.at(uv, chosen, len(here))
    return found


def _made(detail: Detail, look: Float32[Tensor, "11 V"]) -> Reflecting:
    """As `file_material` makes it of the means around vertices."""
    diffuse, metal, dielectric, roughness = look[0:3].T, look[3:6].T, look[6:9].T, look[9]
    body = (diffuse if detail.gloss else diffuse + metal).clamp(0, 1)
    nothing = torch.zeros(len(body), 1), torch.full((len(body),), -1)
    if detail.glosses is None:
        return Reflecting(body, *nothing)
    reflectance = (dielectric + metal).clamp(0, 1)
    gloss = _nearest(detail.glosses, roughness, reflectance.amax(1))
    specular = torch.ones_like(reflectance)
    for number, brdf in enumerate(detail.glosses.models):
        here = gloss == number
        weight = (reflectance[here] / brdf.f0).clamp(0, 1)  # type: ignore[attr-defined]
        specular[here] = weight
        body[here] *= 1 - weight * reflected(brdf).mean
    return Reflecting(body, specular, gloss)


def _nearest(
    glosses: Glosses, roughness: Float32[Tensor, "V"], reflectance: Float32[Tensor, "V"]
) -> Int64[Tensor, "V"]:
    """Which gloss is nearest in roughness, and in the root of reflectance rather higher; -1 where there is none."""
    # They are GGX, whose width is the square of what files call roughness.
    known = [(float(each.roughness), float(each.f0)) for each in glosses.models]  # type: ignore[attr-defined]
    width, height = torch.tensor(known).sqrt().unbind(1)
    above = height - reflectance.sqrt()[:, None]
    cost = (width - roughness[:, None]) ** 2 + torch.where(above < 0, TOO_LOW, TOO_HIGH) * above**2
    return torch.where(reflectance.sqrt() > 1e-3, cost.argmin(1), -1)
