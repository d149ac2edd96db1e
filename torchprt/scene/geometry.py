"""All objects of a scene as one set of tensors, for tracing and for recording."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from torchprt.brdf import Brdf

from .material import differs
from .object import Object
from .subsurface import Subsurface


@dataclass(frozen=True, eq=False)
class Geometry:
    """What rays meet (`positions`, `faces`: every object, each face once), and what records (`receiver_*`).

    Receivers are the vertices of the receiving objects, object after object in the order of the scene; after all of
    them follow the reverse sides of the two-sided objects: the same positions, negated normals.
    """

    positions: Float64[Tensor, "Vall 3"]
    faces: Int64[Tensor, "F 3"]
    face_object: Int64[Tensor, "F"]
    """The object, by its number in the scene, that each face belongs to."""
    two_sided: Bool[Tensor, "F"]
    receiver_of_vertex: Int64[Tensor, "Vall"]
    """The receiver on the front of each vertex; -1 for blockers, which are black, and for mirrors."""
    back_receiver_of_vertex: Int64[Tensor, "Vall"]
    """The receiver on the reverse of each vertex; -1 where the surface is one-sided."""
    receiver_positions: Float64[Tensor, "V 3"]
    receiver_normals: Float64[Tensor, "V 3"]
    """Unit length, or zero: such a receiver gets no light by its own rays."""
    albedo: Float32[Tensor, "V C"]
    """Of the receivers: three channels if the albedo of any of them is coloured, else one."""
    display_faces: Int64[Tensor, "Fd 3"]
    """Faces over receivers, to draw them: the fronts, then the reverse sides wound the other way."""
    slices: tuple[slice, ...]
    """For each object of the scene the rows of its front receivers; empty for blockers and mirrors."""
    back_slices: tuple[slice, ...]
    """For each object of the scene the rows of its reverse receivers; empty where it has none."""
    glossy: Int64[Tensor, "G"]
    """The receivers whose material has a gloss, ascending."""
    gloss: tuple[Brdf, ...]
    """The different glosses of the scene."""
    gloss_of_glossy: Int64[Tensor, "G"]
    """Which of them lies on each glossy receiver."""
    tangents: Float64[Tensor, "G 3"]
    """Of the glossy receivers: unit length, orthogonal to the normal, the same on both sides of a surface."""
    specular: Float32[Tensor, "G S"]
    """Weight of the gloss: three channels if any is coloured, else one."""
    partner: Int64[Tensor, "V"]
    """The receiver on the other side of a translucent surface; -1 where nothing comes through."""
    translucency: Float32[Tensor, "V"]
    mirror: Int64[Tensor, "F"]
    """Which mirror each face is of, -1 for none."""
    reflectance: Float32[Tensor, "K M"]
    """Of each mirror along its normal: three channels if any is coloured, else one."""
    mirror_normals: Float64[Tensor, "Vm 3"]
    """Of all vertices, if there are mirrors, else empty."""
    names: tuple[str, ...]
    """Of the mesh of each object of the scene."""
    roles: tuple[str, ...]
    """Of each object of the scene."""
    media: tuple[tuple[Subsurface, float] | None, ...]
    """For each object of the scene the medium below its surface and how many mm a unit is; None without."""
    tangent_fields: tuple[str, ...]
    """For each object of the scene where its tangents come from: "uv", "smooth", or "" if it is not glossy."""

    @property
    def receivers(self) -> int:
        """How many receivers there are, reverse sides included."""
        return len(self.receiver_positions)


def gather(objects: Sequence[Object]) -> Geometry:
    """The geometry of `objects`, in their order."""
    sizes = [len(object.mesh.positions) for object in objects]
    starts = _starts(sizes)
    receiving = [object.receives for object in objects]
    # The vertices of every object that record on their reverse.
    reverse = [torch.nonzero(o.two_sided)[:, 0] if o.receives else torch.zeros(0, dtype=torch.int64) for o in objects]
    fronts = _starts([size * on for size, on in zip(sizes, receiving, strict=True)])
    backs = _starts([len(each) for each in reverse], fronts[-1])
    slices = tuple(slice(a, b) for a, b in itertools.pairwise(fronts))
    back_slices = tuple(slice(a, b) for a, b in itertools.pairwise(backs))
    front_objects = [object for object, on in zip(objects, receiving, strict=True) if on]
    # Every object with the vertices that record, on the fronts and then on the reverse sides.
    both = [(o, torch.arange(len(o.mesh.positions))) for o in front_objects]
    both += [(o, each) for o, each in zip(objects, reverse, strict=True) if len(each)]
    none = torch.zeros(0, 3, dtype=torch.float64)
    channels = 3 if any(differs(object.albedo) for object in front_objects) else 1
    numbering, back_numbering = _numbering(sizes, slices), _back_numbering(sizes, back_slices, reverse)
    faces = torch.cat([object.mesh.faces + start for object, start in zip(objects, starts[:-1], strict=True)])
    two_sided = (back_numbering[faces] >= 0).all(1)
    shown = (numbering[faces] >= 0).all(1)
    shiny = [
        (object, chosen[at], at + start, object.gloss_of_vertex[chosen[at]])
        for (object, chosen), start in zip(both, _starts([len(chosen) for _, chosen in both])[:-1], strict=True)
        if object.glossy
        for at in [torch.nonzero(object.gloss_of_vertex[chosen] >= 0)[:, 0]]
    ]
    gloss = distinct([brdf for object, _, _, which in shiny for brdf in _used(object, which)])
    specular_channels = 3 if any(differs(object.specular) for object, *_ in shiny) else 1
    whole = torch.zeros(0, dtype=torch.int64)
    mirrors = [each.material.reflectance for each in objects if each.material.reflectance is not None]
    mirror_channels = 3 if any(differs(each) for each in mirrors) else 1
    return Geometry(
        positions=torch.cat([object.mesh.positions for object in objects]),
        faces=faces,
        face_object=torch.cat([torch.full((len(o.mesh.faces),), number) for number, o in enumerate(objects)]),
        two_sided=two_sided,
        receiver_of_vertex=numbering,
        back_receiver_of_vertex=back_numbering,
        receiver_positions=torch.cat([none, *(object.mesh.positions[chosen] for object, chosen in both)]),
        receiver_normals=torch.cat(
            [
                none,
                *(o.mesh.normals for o in front_objects),
                *(-o.mesh.normals[chosen] for o, chosen in both[len(front_objects) :]),
            ]
        ),
        albedo=torch.cat([torch.zeros(0, channels), *(_channels(o.albedo[chosen], channels) for o, chosen in both)]),
        display_faces=torch.cat([numbering[faces[shown]], back_numbering[faces[two_sided]].flip(1)]),
        slices=slices,
        back_slices=back_slices,
        glossy=torch.cat([whole, *(rows for _, _, rows, _ in shiny)]),
        gloss=gloss,
        gloss_of_glossy=torch.cat([whole, *(_numbers(object, gloss)[which] for object, _, _, which in shiny)]),
        tangents=torch.cat([none, *(object.mesh.tangent_field[chosen] for object, chosen, _, _ in shiny)]),
        specular=torch.cat(
            [
                torch.zeros(0, specular_channels),
                *(_channels(object.specular[chosen], specular_channels) for object, chosen, _, _ in shiny),
            ]
        ),
        partner=_partners(objects, slices, back_slices, backs[-1]),
        translucency=torch.cat(
            [torch.zeros(0), *(torch.full((len(chosen),), float(o.material.translucency)) for o, chosen in both)]
        ),
        mirror=_mirror_of_faces(objects),
        reflectance=torch.cat(
            [torch.zeros(0, mirror_channels), *(_channels(each, mirror_channels) for each in mirrors)]
        ),
        mirror_normals=torch.cat([object.mesh.normals for object in objects]) if mirrors else none,
        names=tuple(object.mesh.name for object in objects),
        roles=tuple(object.role for object in objects),
        media=tuple(_medium(object) for object in objects),
        tangent_fields=tuple(object.tangent_field for object in objects),
    )


def _medium(object: Object) -> tuple[Subsurface, float] | None:
    medium, millimetres = object.material.medium, object.material.millimetres
    return None if medium is None or millimetres is None or not object.receives else (medium, float(millimetres))


def _used(object: Object, which: Int64[Tensor, "g"]) -> list[Brdf]:
    """The glosses of an object that lie on any of its receivers."""
    return [object.material.glosses[number] for number in which.unique().tolist()]


def _numbers(object: Object, gloss: tuple[Brdf, ...]) -> Int64[Tensor, "models"]:
    """The numbers of the glosses of an object among those of the scene, -1 for those that are nowhere."""
    found = [
        next((number for number, each in enumerate(gloss) if _same(brdf, each)), -1) for brdf in object.material.glosses
    ]
    return torch.tensor(found, dtype=torch.int64)


def distinct(all_gloss: Sequence[Brdf]) -> tuple[Brdf, ...]:
    """Glosses without those that are as a former one."""
    found: list[Brdf] = []
    for brdf in all_gloss:
        if not any(_same(brdf, each) for each in found):
            found.append(brdf)
    return tuple(found)


def _same(one: Brdf, other: Brdf) -> bool:
    try:
        return one is other or (hash(one) == hash(other) and one == other)
    except TypeError:  # Tables have no hash: each is its own.
        return False


def _partners(
    objects: Sequence[Object], slices: tuple[slice, ...], back_slices: tuple[slice, ...], receivers: int
) -> Int64[Tensor, "V"]:
    partner = torch.full((receivers,), -1)
    for object, front, back in zip(objects, slices, back_slices, strict=True):
        if object.receives and object.material.translucency:
            partner[front] = torch.arange(back.start, back.stop)
            partner[back] = torch.arange(front.start, front.stop)
    return partner


def _mirror_of_faces(objects: Sequence[Object]) -> Int64[Tensor, "F"]:
    found, number = [], 0
    for object in objects:
        is_mirror = object.material.mirror is not None
        found.append(torch.full((len(object.mesh.faces),), number if is_mirror else -1))
        number += is_mirror
    return torch.cat(found)


def _starts(sizes: list[int], first: int = 0) -> list[int]:
    starts = [first]
    for size in sizes:
        starts.append(starts[-1] + size)
    return starts


def _numbering(sizes: list[int], slices: tuple[slice, ...]) -> Int64[Tensor, "Vall"]:
    return torch.cat(
        [
            torch.arange(rows.start, rows.stop) if rows.stop > rows.start else torch.full((size,), -1)
            for size, rows in zip(sizes, slices, strict=True)
        ]
    )


def _back_numbering(
    sizes: list[int], slices: tuple[slice, ...], reverse: list[Int64[Tensor, "_"]]
) -> Int64[Tensor, "Vall"]:
    result = torch.full((sum(sizes),), -1)
    for start, rows, vertices in zip(_starts(sizes)[:-1], slices, reverse, strict=True):
        result[vertices + start] = torch.arange(rows.start, rows.stop)
    return result


def _channels(albedo: Float32[Tensor, "V C"], channels: int) -> Float32[Tensor, "V D"]:
    return albedo[:, :1] if channels == 1 else albedo.expand(-1, 3)
