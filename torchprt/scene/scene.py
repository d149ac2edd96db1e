"""Objects that share light, and what a bake of them requires."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from torchprt.errors import InputError

from .dress import Source, object_of
from .geometry import Geometry, gather
from .material import Albedo, Material
from .material_file import read_material
from .mesh import Mesh
from .object import Object
from .reading import read_mesh


@dataclass(frozen=True)
class Requirements:
    """What a bake must store for a scene, and no more."""

    kind: Literal["diffuse", "glossy"]
    """Which kind of transfer: glossy as soon as one receiver has a gloss."""
    channels: int
    """1, or 3 if light comes by way of coloured surfaces."""
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
            raise InputError(
                "scene has only blockers and mirrors, which record nothing: give at least one mesh that receives light"
            )

    def requires(self, bounces: int | float = 0) -> Requirements:
        """What a bake with that many bounces of light (or `math.inf`, until it is spent) needs.

        Raises InputError if `bounces` is negative or not a whole number.
        """
        if not (bounces >= 0 and (math.isinf(bounces) or bounces == int(bounces))):
            raise InputError(f"bounces is {bounces}: give 0 for shadows alone, a whole number, or infinity")
        # Mirrors and media colour light without a bounce.
        coloured = any(
            each.coloured
            for each in self.objects
            if bounces or each.material.mirror is not None or (each.receives and each.material.medium is not None)
        )
        kind: Literal["diffuse", "glossy"] = "glossy" if any(each.glossy for each in self.objects) else "diffuse"
        return Requirements(kind=kind, channels=3 if coloured else 1, bounces=bounces)

    def on_ground(self, height: float | None = None, albedo: Albedo = 0.5) -> "Scene":
        """The same on a ground that receives its shadow: a disc at `height` along +y, of that albedo.

        At the lowest point of the receivers by default. It is eight times as wide as the model, fine below it and
        coarser outward. Pictures fade it out and do not frame it, and models leave it out unless asked.
        Raises InputError if there is a ground already, `height` is not finite or nothing reaches above it, or if the
        albedo is outside [0, 1].
        """
        from .ground import ground

        return Scene([*self.objects, *ground(self.objects, height, albedo)])

    def geometry(self) -> Geometry:
        """All objects as one set of tensors."""
        return gather(self.objects)

    def __str__(self) -> str:
        """The report of every mesh, under its name and role, and what lies on it besides its albedo."""
        return "\n\n".join(
            "\n".join(
                [
                    f"{o.mesh.name} ({o.role if o.material.mirror is None else 'mirror'})",
                    str(o.mesh.report),
                    *_finish(o),
                ]
            )
            for o in self.objects
        )


def _finish(object: Object) -> list[str]:
    lines = list(object.material.notes) if object.receives else []
    if object.glossy:
        source = {
            "uv": "from the mesh (texture coordinates or its own)",
            "smooth": "a smooth field, because the mesh has no texture coordinates",
        }[object.tangent_field]
        lines.append(f"Gloss {', '.join(each.spec for each in object.material.glosses)}, tangents {source}.")
    if object.receives and object.material.translucency:
        lines.append(f"Translucency {object.material.translucency:g}, both sides record.")
    medium = object.material.medium
    if object.receives and medium is not None and object.material.millimetres is not None:
        path = ", ".join(f"{length:.2g}" for length in medium.mean_free_path.tolist())
        lines.append(
            f"Subsurface {medium.text}, a unit is {object.material.millimetres:g} mm: mean free path {path} mm, "
            f"edges {object.median_edge * object.material.millimetres:.2g} mm (median)."
        )
    return lines


def load(
    sources: Source | Sequence[Source],
    albedo: Albedo | None = None,
    two_sided: bool | None = None,
    blockers: Source | Sequence[Source] = (),
    material: Material | str | None = None,
    mirrors: Source | Sequence[Source] = (),
    metal: Material | str = "mirror",
) -> Scene:
    """The scene of one or several mesh files (or meshes), of blockers that only cast shadows, and of mirrors.

    - `albedo` is one number, three, a tensor [V, 1] or [V, 3], "vertex" for the colours of the vertices in the files,
      or "file" for base colour times texture times vertex colour: the default without a material, where the file has
      any of them; else .5.
    - `material` is a material, or text as `read_material` takes, "ggx:0.3,0.04" or the name of a .toml file, or "file"
      for albedo and gloss of the file's own. An albedo given beside it replaces that of the material.
    - `metal` is the material of `mirrors`, as text "mirror", "mirror:.95,.64,.54" or "mirror:gold".
    - `two_sided` says whether both sides receive light, instead of the material or the file.

    The name of a .toml file alone is that of a whole scene, as `read_scene` reads it; it says its materials itself.

    Raises InputError as `read_mesh`, `read_scene`, `read_material` and `Material` do, if there is no mesh, or if a
    scene comes with other meshes or a material.
    """
    objects = load_objects(sources, albedo, two_sided, blockers, material)
    return Scene([*objects, *(mirror_of(source, metal) for source in _several(mirrors))])


def load_objects(
    sources: Source | Sequence[Source],
    albedo: Albedo | None = None,
    two_sided: bool | None = None,
    blockers: Source | Sequence[Source] = (),
    material: Material | str | None = None,
) -> list[Object]:
    """The objects that `load` makes a scene of: a mirror alone is none, but on a ground it is."""
    more = _blocking(blockers)
    scenes = [each for each in _several(sources) if not isinstance(each, Mesh) and is_scene(each)]
    if scenes:
        if len(_several(sources)) > 1 or albedo is not None or material is not None or two_sided is not None:
            raise InputError(
                f"{scenes[0]} is a scene, which says its meshes and their materials itself: leave other meshes, "
                "albedo, material and two_sided out"
            )
        from .scene_file import read_scene

        scene = read_scene(scenes[0])
        return [*scene.objects, *more]
    if isinstance(material, str) and material != "file":
        material = read_material(material)
    receiving = [object_of(source, albedo, two_sided, material) for source in _several(sources)]
    return receiving + more


def is_scene(source: str | os.PathLike[str]) -> bool:
    """Whether a file is one of a whole scene, by its name."""
    return os.fspath(source).lower().endswith(".toml")


def _blocking(blockers: Source | Sequence[Source]) -> list[Object]:
    return [Object(_mesh(source), Material(0.0), "blocker") for source in _several(blockers)]


def mirror_of(source: Source, metal: Material | str = "mirror") -> Object:
    """A mesh or a mesh file as a mirror. Raises InputError unless `metal` is the material of one."""
    material = read_material(metal) if isinstance(metal, str) else metal
    if material.mirror is None:
        raise InputError(
            f'metal is {metal!r}, which is no mirror: give "mirror", "mirror:.95,.64,.54" or "mirror:gold"'
        )
    return Object(_mesh(source), material)


def _several(sources: Source | Sequence[Source]) -> Sequence[Source]:
    return [sources] if isinstance(sources, str | os.PathLike | Mesh) else sources


def _mesh(source: Source) -> Mesh:
    return source if isinstance(source, Mesh) else read_mesh(source)
