"""What the materials of a file say at every vertex of its mesh."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64, Int64, UInt8
from torch import Tensor

from torchprt.errors import InputError

from .footprint import surface_means
from .mesh import Mesh
from .paint import NONE, Paint
from .reading import Raw, read_paints, read_raw
from .texture import WRAPS, Map, Picture, Texture
from .weld import weld

SMOOTH = 0.9
"""Vertices at one place are one if the cosine between their normals is above this: a seam, and no edge."""


class Look(NamedTuple):
    """Means over the surface around each vertex."""

    diffuse: Float64[np.ndarray, "V 3"]
    """Base colour of what is not metallic, linear."""
    metal: Float64[np.ndarray, "V 3"]
    """Base colour of what is."""
    dielectric: Float64[np.ndarray, "V 3"]
    """Reflectance along the normal of what is not metallic."""
    roughness: Float64[np.ndarray, "V"]
    """As glTF has it."""
    notes: tuple[str, ...]
    """What could not be taken, in sentences."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh and the materials of its file. Made by `read_surface`."""

    mesh: Mesh
    paints: tuple[Paint, ...]
    """The materials, and last that of faces without any; empty if the file has none."""
    paint_of_face: Int64[np.ndarray, "F"]
    raw: Raw
    """What was read, with all sets of texture coordinates."""

    @property
    def used(self) -> list[Paint]:
        """The materials that faces have."""
        return [self.paints[number] for number in np.unique(self.paint_of_face)] if self.paints else []

    @property
    def coloured(self) -> bool:
        """Whether the file says a colour anywhere: of a material, a picture or a vertex."""
        return self.raw.tint is not None or any(paint.coloured for paint in self.used)

    @property
    def glossy(self) -> bool:
        """Whether a material of the file reflects otherwise than diffusely."""
        return any(paint.glossy for paint in self.used)

    @property
    def two_sided(self) -> Bool[Tensor, "V"]:
        """Which vertices lie on a surface whose both sides the file shows.

        None of a closed surface, whose inside nobody sees.
        """
        result = np.zeros(len(self.mesh.positions), dtype=bool)
        report = self.mesh.report
        if not report.watertight or report.inside_out:
            for number, paint in enumerate(self.paints):
                if paint.two_sided:
                    result[self.mesh.faces.numpy()[self.paint_of_face == number]] = True
        return torch.from_numpy(result)

    def look(self, gloss: bool) -> Look:
        """Means of what the materials say over the surface that each vertex stands for.

        Without `gloss` all is diffuse, and a metal has its base colour.

        - The mean is weighted with the hat function of the vertex, 1 there, 0 at the other corners of its faces and
          linear between, and with area: what a linear interpolation of the vertices is then right for, in the mean.
        - Vertices at one place, of one material and with normals that agree are one: a seam of texture coordinates.
        - The colours of vertices multiply the mean, each its own.
        """
        faces = self.mesh.faces.numpy()
        corners = self.mesh.positions.numpy()[faces]
        size = float(np.abs(corners).max()) or 1.0
        areas = np.linalg.norm(np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0) / size), axis=1)
        # A vertex of none but faces without area takes their mean.
        areas += 1e-12 * areas.max()
        group = self._groups()
        count = int(group.max(initial=-1)) + 1
        total, notes = np.zeros((count, WIDTH)), []
        for number, paint in enumerate(self.paints or (NONE,)):
            some = np.flatnonzero(self.paint_of_face == number)
            if len(some):
                sums, said = _sums(paint, group[faces[some]], areas[some], count, self.raw, some, gloss)
                total += sums
                notes += said
        weight = total[:, -1:]
        mean = np.divide(total, weight, out=np.full_like(total, 0.5), where=weight > 0)[group]
        tint = np.ones((len(group), 3)) if self.raw.tint is None else self.raw.tint
        return Look(mean[:, 0:3] * tint, mean[:, 3:6] * tint, mean[:, 6:9], mean[:, 9], tuple(notes))

    def _groups(self) -> Int64[np.ndarray, "V"]:
        """A number for every vertex, the same for those that are one."""
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        count = len(self.mesh.positions)
        place = weld(self.mesh.positions.numpy())
        paint = np.full(count, -1)
        paint[self.mesh.faces.numpy().ravel()] = np.repeat(self.paint_of_face, 3)
        normals = self.mesh.normals.numpy()
        order = np.argsort(place, kind="stable")
        most = int(np.bincount(place).max(initial=1))
        one, other = [], []
        for step in range(1, min(most, 64)):
            a, b = order[:-step], order[step:]
            agree = (place[a] == place[b]) & (paint[a] == paint[b])
            agree &= np.einsum("ij,ij->i", normals[a], normals[b]) > SMOOTH
            one.append(a[agree])
            other.append(b[agree])
        pairs = (np.concatenate([[], *one]).astype(int), np.concatenate([[], *other]).astype(int))
        graph = coo_matrix((np.ones(len(pairs[0]), dtype=bool), pairs), (count, count))
        label: np.ndarray = connected_components(graph, directed=False)[1].astype(np.int64)
        return label


WIDTH = 11
"""Diffuse, metal, dielectric reflectance, roughness, weight."""


def read_surface(path: str | os.PathLike[str]) -> Surface:
    """The mesh of a file, as `read_mesh` has it, and the materials that the file gives it.

    glTF: its materials. .obj: those of its .mtl. .ply: the picture that a comment `TextureFile` names. Pictures are
    read when they are asked for.
    Raises InputError as `read_mesh`, and if the materials are damaged.
    """
    mesh, raw = read_raw(path)
    paints = read_paints(raw, path)
    if raw.materials is None or not paints:
        return Surface(mesh, paints, np.full(len(mesh.faces), len(paints) - 1 if paints else 0), raw)
    if raw.materials.max(initial=-1) >= len(paints) - 1:
        raise InputError(f"{path} names material {raw.materials.max()} of {len(paints) - 1}: export the mesh again")
    return Surface(mesh, paints, np.where(raw.materials < 0, len(paints) - 1, raw.materials), raw)


def texture_albedo(mesh: Mesh, texels: UInt8[np.ndarray, "H W 3"], wrap: str = "repeat") -> Float32[Tensor, "V 3"]:
    """Albedo of the vertices of a mesh with texture coordinates under a picture of sRGB, row 0 at v = 0.

    The mean over the surface around each vertex, as `Surface.look` has it.
    Raises InputError if the mesh has no texture coordinates or if `wrap` is not "repeat", "mirror" or "clamp".
    """
    if mesh.uv is None:
        raise InputError(f"{mesh.name} has no texture coordinates: give them to make_mesh as uv")
    if wrap not in WRAPS:
        raise InputError(f"wrap is {wrap!r}: give one of {', '.join(WRAPS)}")
    alpha = np.full((*texels.shape[:2], 1), 255, np.uint8)
    picture = Picture("picture", bytes, np.concatenate([texels, alpha], axis=2))
    raw = Raw(mesh.positions.numpy(), mesh.faces.numpy(), uv=mesh.uv.numpy())
    surface = Surface(
        mesh,
        (Paint("picture", colour_map=Map(picture, srgb=True, wrap=(wrap, wrap))),),
        np.zeros(len(mesh.faces), np.int64),
        raw,
    )
    return torch.from_numpy(surface.look(gloss=False).diffuse).float()


class Painted:
    """One material of a file on some faces, its pictures in memory.

    `maps` are the pictures that say how it reflects; `notes` what could not be taken, in sentences.
    """

    def __init__(self, paint: Paint, raw: Raw, some: Int64[np.ndarray, "f"], gloss: bool):
        self.paint = paint
        self.notes: list[str] = []
        base = opened(paint, paint.colour_map, raw, some, self.notes)
        shine = opened(paint, paint.gloss_map, raw, some, self.notes) if gloss else None
        self.maps = [each for each in (base, shine) if each is not None]
        self._base, self._shine, self._gloss = base is not None, shine is not None, gloss
        self._factor = torch.tensor(paint.colour or (1.0, 1.0, 1.0))[:, None]
        self._reflectance = torch.tensor(paint.reflectance)[:, None]

    def at(self, uv: Sequence[Float32[Tensor, "n 2"]], level: Sequence[int], number: int) -> Float32[Tensor, "11 n"]:
        """What lies at `number` points, where they are in each of the `maps`, these made smaller `level` times.

        All is multiplied by what is seen of it, which stands last: where it is transparent it has no part in a mean.
        """
        paint = self.paint
        looked = [each.texture.at(uv[at], level[at]) for at, each in enumerate(self.maps)]
        colour = looked[0] if self._base else torch.ones(3, number)
        shining = looked[-1] if self._shine else torch.ones(3, number)
        seen = torch.ones(number)
        if paint.alpha != "OPAQUE" and len(colour) == 4:
            seen = colour[3] if paint.alpha == "BLEND" else (colour[3] >= paint.cutoff).float()
            # Where nothing is seen, all is: better than a division by nothing.
            seen = seen + 1e-6
        metallic = paint.metallic * shining[2] if self._gloss else torch.zeros(number)
        colour = colour[:3] * self._factor * seen
        roughness = (paint.roughness * shining[1] * seen)[None]
        return torch.cat(
            [
                colour * (1 - metallic),
                colour * metallic,
                self._reflectance * (1 - metallic) * seen,
                roughness,
                seen[None],
            ]
        )


def _sums(
    paint: Paint, faces: np.ndarray, areas: np.ndarray, count: int, raw: Raw, some: np.ndarray, gloss: bool
) -> tuple[Float64[np.ndarray, "count 11"], list[str]]:
    """What the faces `some` of one material add to the vertices around them, and what could not be taken."""
    painted = Painted(paint, raw, some, gloss)

    def sample(which: np.ndarray, points: np.ndarray, level: Sequence[int]) -> Tensor:
        uv = [(torch.from_numpy(points) @ each.corners[which]).reshape(-1, 2) for each in painted.maps]
        return painted.at(uv, level, len(which) * len(points))

    if painted.maps:
        texels = [each.uv * each.texture.size for each in painted.maps]
        return surface_means(faces, areas, count, texels, sample, WIDTH), painted.notes
    # All the same everywhere.
    values = painted.at([], (), 1)[:, 0].double().numpy()
    weight = np.bincount(faces.ravel(), np.repeat(areas / 3, 3), minlength=count)
    return weight[:, None] * values, painted.notes


class Opened(NamedTuple):
    """A picture in memory, and where the corners of some faces are in it."""

    texture: Texture
    uv: Float64[np.ndarray, "F 3 2"]
    corners: Tensor


def opened(paint: Paint, given: Map | None, raw: Raw, some: np.ndarray, notes: list[str]) -> Opened | None:
    """A picture of a material on the faces `some`; None, and why, if it cannot be had."""
    if given is None:
        return None
    uv = raw.uv if given.set == 0 else raw.more_uv.get(given.set)
    if uv is None or not np.isfinite(uv[some]).any():
        notes.append(f"'{paint.name}' has the picture {given.picture.name} and no texture coordinates: left out")
        return None
    corners = given.corners(uv[some])
    bad = ~np.isfinite(corners).all(axis=(1, 2))
    if bad.any():
        notes.append(f"'{paint.name}' has {bad.sum()} faces without texture coordinates, which show (0, 0)")
        corners[bad] = given.corners(np.zeros((1, 3, 2)))
    try:
        texture = given.texture()
    except InputError as fault:
        notes.append(f"'{paint.name}' has no picture, its factor alone is taken: {fault}")
        return None
    return Opened(texture, corners, torch.from_numpy(texture.near_origin(corners)))
