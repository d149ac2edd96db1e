"""Objects that share light, and what a bake of them requires."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from torchprt.errors import InputError

from .geometry import Geometry, gather
from .material import Albedo, Material
from .mesh import Mesh
from .object import Object
from .reading import read_mesh

Source = str | os.PathLike[str] | Mesh
"""A mesh, or the name of the file that holds it."""


@dataclass(frozen=True)
class Requirements:
    """What a bake must store for a scene, and no more."""

    kind: Literal["diffuse"]
    """Which kind of transfer."""
    channels: int
    """1, or 3 if light bounces off coloured surfaces."""
    bounces: int | float
    """How often light is followed from surface to surface: 0 for shadows alone, infinite for until it is spent."""

    @property
    def hits(self) -> bool:
        """Whether it matters what a ray meets, not only whether it meets anything."""
        return self.bounces > 0


@dataclass(frozen=True, eq=False)
class Scene:
    """Objects that share light and shadow.

    Raises InputError if there are none, or if none of them receives light.
    """

    objects: tuple[Object, ...]

    def __init__(self, objects: Sequence[Object]) -> None:
        object.__setattr__(self, "objects", tuple(objects))
        if not self.objects:
            raise InputError("scene has no objects: give at least one mesh that receives light")
        if not any(each.receives for each in self.objects):
            raise InputError("scene has only blockers: give at least one mesh that receives light")

    def requires(self, bounces: int | float = 0) -> Requirements:
        """What a bake with that many bounces of light (or `math.inf`, until it is spent) needs.

        Raises InputError if `bounces` is negative or not a whole number.
        """
        if not (bounces >= 0 and (math.isinf(bounces) or bounces == int(bounces))):
            raise InputError(f"bounces is {bounces}: give 0 for shadows alone, a whole number, or infinity")
        coloured = any(each.coloured for each in self.objects)
        return Requirements(kind="diffuse", channels=3 if bounces and coloured else 1, bounces=bounces)

    def geometry(self) -> Geometry:
        """All objects as one set of tensors."""
        return gather(self.objects)

    def __str__(self) -> str:
        """The report of every mesh, under its name and role."""
        return "\n\n".join(f"{each.mesh.name} ({each.role})\n{each.mesh.report}" for each in self.objects)


def load(
    sources: Source | Sequence[Source],
    albedo: Albedo = 0.5,
    two_sided: bool = False,
    blockers: Source | Sequence[Source] = (),
) -> Scene:
    """The scene of one or several mesh files (or meshes) of one material, and of blockers that only cast shadows.

    `albedo` is one number, three, a tensor [V, 1] or [V, 3], or "vertex" for the colours in the files.

    Raises InputError as `read_mesh` and `Material` do, and if there is no mesh.
    """
    material = Material(albedo, two_sided)
    receiving = [Object(_mesh(source), material) for source in _several(sources)]
    blocking = [Object(_mesh(source), Material(0.0), "blocker") for source in _several(blockers)]
    return Scene(receiving + blocking)


def _several(sources: Source | Sequence[Source]) -> Sequence[Source]:
    return [sources] if isinstance(sources, str | os.PathLike | Mesh) else sources


def _mesh(source: Source) -> Mesh:
    return source if isinstance(source, Mesh) else read_mesh(source)
