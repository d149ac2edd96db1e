"""All objects of a scene as one set of tensors, for tracing and for recording."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float32, Float64, Int64
from torch import Tensor

from .material import differs
from .object import Object


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
    """The receiver on the front of each vertex; -1 for blockers, which are black."""
    back_receiver_of_vertex: Int64[Tensor, "Vall"]
    """The receiver on the reverse of each vertex; -1 where the surface is one-sided."""
    receiver_positions: Float64[Tensor, "V 3"]
    receiver_normals: Float64[Tensor, "V 3"]
    """Unit length, or zero: such a receiver gets no light."""
    albedo: Float32[Tensor, "V C"]
    """Of the receivers: three channels if the albedo of any of them is coloured, else one."""
    display_faces: Int64[Tensor, "Fd 3"]
    """Faces over receivers, to draw them: the fronts, then the reverse sides wound the other way."""
    slices: tuple[slice, ...]
    """For each object of the scene the rows of its front receivers; empty for blockers."""
    back_slices: tuple[slice, ...]
    """For each object of the scene the rows of its reverse receivers; empty where it has none."""

    @property
    def receivers(self) -> int:
        """How many receivers there are, reverse sides included."""
        return len(self.receiver_positions)


def gather(objects: Sequence[Object]) -> Geometry:
    """The geometry of `objects`, in their order."""
    sizes = [len(object.mesh.positions) for object in objects]
    starts = _starts(sizes)
    receiving = [object.receives for object in objects]
    reversible = [object.receives and object.material.two_sided for object in objects]
    fronts = _starts([size * on for size, on in zip(sizes, receiving, strict=True)])
    backs = _starts([size * on for size, on in zip(sizes, reversible, strict=True)], fronts[-1])
    slices = tuple(slice(a, b) for a, b in itertools.pairwise(fronts))
    back_slices = tuple(slice(a, b) for a, b in itertools.pairwise(backs))
    front_objects = [object for object, on in zip(objects, receiving, strict=True) if on]
    back_objects = [object for object, on in zip(objects, reversible, strict=True) if on]
    both = front_objects + back_objects
    none = torch.zeros(0, 3, dtype=torch.float64)
    channels = 3 if any(differs(object.albedo) for object in front_objects) else 1
    display = [
        object.mesh.faces + rows.start for object, rows, on in zip(objects, slices, receiving, strict=True) if on
    ]
    display += [
        object.mesh.faces.flip(1) + rows.start
        for object, rows, on in zip(objects, back_slices, reversible, strict=True)
        if on
    ]
    return Geometry(
        positions=torch.cat([object.mesh.positions for object in objects]),
        faces=torch.cat([object.mesh.faces + start for object, start in zip(objects, starts[:-1], strict=True)]),
        face_object=torch.cat([torch.full((len(o.mesh.faces),), number) for number, o in enumerate(objects)]),
        two_sided=torch.cat([torch.full((len(o.mesh.faces),), o.material.two_sided) for o in objects]),
        receiver_of_vertex=_numbering(sizes, slices),
        back_receiver_of_vertex=_numbering(sizes, back_slices),
        receiver_positions=torch.cat([none, *(object.mesh.positions for object in both)]),
        receiver_normals=torch.cat(
            [none, *(o.mesh.normals for o in front_objects), *(-o.mesh.normals for o in back_objects)]
        ),
        albedo=torch.cat([torch.zeros(0, channels), *(_channels(object.albedo, channels) for object in both)]),
        display_faces=torch.cat([torch.zeros(0, 3, dtype=torch.int64), *display]),
        slices=slices,
        back_slices=back_slices,
    )


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


def _channels(albedo: Float32[Tensor, "V C"], channels: int) -> Float32[Tensor, "V D"]:
    return albedo[:, :1] if channels == 1 else albedo.expand(-1, 3)
