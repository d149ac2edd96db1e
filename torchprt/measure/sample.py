"""A few receivers of a scene or of its transfer, so that a question costs seconds."""

from __future__ import annotations

import dataclasses
import warnings

import torch
from jaxtyping import Int, Int64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.scene import EnergyWarning, Geometry, Material, Object, Scene, make_mesh
from torchprt.transfer import Transfer, Vertices


def sample_receivers(scene: Scene, count: int, seed: int = 0) -> tuple[Scene, Int64[Tensor, "g"]]:
    """A scene of the same shadows in which little more than `count` glossy receivers record, and which those are.

    They are drawn at random from the glossy receivers of `scene` that have a normal and a face; one face of each
    records, of albedo 0 and specular weight 1, and all surfaces block. The second result numbers them among the glossy
    receivers of the new scene, ascending: the corners of the same faces record too. For shadows alone: what was glossy
    is black where rays hit it.
    Raises InputError if `count` is below 1 or there are fewer such receivers.
    """
    geometry = scene.geometry()
    face = torch.full((geometry.receivers,), -1)
    corners = geometry.display_faces.flatten()
    face[corners] = torch.arange(len(geometry.display_faces)).repeat_interleave(3)
    glossy = geometry.glossy
    usable = torch.nonzero((face[glossy] >= 0) & (geometry.receiver_normals[glossy] != 0).any(-1))[:, 0]
    if not 1 <= count <= len(usable):
        raise InputError(f"count is {count}: the scene has {len(usable)} glossy receivers, give a number up to that")
    chosen = usable[_drawn(len(usable), count, seed)]
    objects: list[Object] = []
    rows = []
    for index in torch.unique(geometry.gloss_of_glossy[chosen]).tolist():
        wanted = glossy[chosen[geometry.gloss_of_glossy[chosen] == index]]
        used, faces = _corners_of(geometry, face[wanted])
        rows.append(torch.searchsorted(used, wanted.sort().values) + sum(len(each.mesh.positions) for each in objects))
        objects.append(_recording(geometry, used, faces, Material(0.0, gloss=geometry.gloss[index])))
    return Scene([*objects, *_others(geometry)]), torch.cat(rows)


def sample_scene(scene: Scene, count: int, seed: int = 0) -> tuple[Scene, Int64[Tensor, "v"], Int64[Tensor, "v"]]:
    """A scene of the same shadows in which little more than `count` receivers record, with the materials they have.

    As `sample_receivers`, but of all receivers, diffuse and glossy, fronts and reverse sides, each with its albedo and
    its gloss; and one is drawn of each of `count` runs of them, because those that follow each other in a mesh are
    alike. Gives the scene, the numbers of the chosen receivers in it, and those in `scene`, in the same order.
    For shadows alone: other surfaces are black where rays hit them. Raises InputError if `count` is below 1 or there
    are fewer receivers that have a normal and a face, and for translucent surfaces, whose sides need each other.
    """
    geometry = scene.geometry()
    if any(geometry.media):
        raise InputError("the scene has subsurface scattering, for which a body is needed whole: use it whole")
    if bool((geometry.partner >= 0).any()):
        raise InputError("the scene has translucent surfaces, whose sides need each other: use it whole")
    face = torch.full((geometry.receivers,), -1)
    face[geometry.display_faces.flatten()] = torch.arange(len(geometry.display_faces)).repeat_interleave(3)
    usable = torch.nonzero((face >= 0) & (geometry.receiver_normals != 0).any(-1))[:, 0]
    if not 1 <= count <= len(usable):
        raise InputError(f"count is {count}: the scene has {len(usable)} receivers, give a number up to that")
    runs = torch.arange(count + 1) * len(usable) // count
    within = torch.rand(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    chosen = usable[runs[:-1] + (within * (runs[1:] - runs[:-1])).long()]
    place = torch.full((geometry.receivers,), -1)
    place[geometry.glossy] = torch.arange(len(geometry.glossy))
    gloss = torch.full((geometry.receivers,), -1)
    gloss[geometry.glossy] = geometry.gloss_of_glossy
    objects: list[Object] = []
    rows, numbers = [], []
    for index in torch.unique(gloss[chosen]).tolist():
        wanted = chosen[gloss[chosen] == index].sort().values
        used, faces = _corners_of(geometry, face[wanted])
        material = Material(geometry.albedo[used])
        if index >= 0:
            # Corners of the same faces without this gloss record nothing that is asked for.
            weight = torch.where((gloss[used] == index)[:, None], geometry.specular[place[used]], 0.0)
            body = torch.where((gloss[used] == index)[:, None], geometry.albedo[used], 0.0)
            with warnings.catch_warnings():
                # It was told when the scene was made.
                warnings.simplefilter("ignore", EnergyWarning)
                material = Material(body, gloss=geometry.gloss[index], specular=weight)
        rows.append(torch.searchsorted(used, wanted) + sum(len(each.mesh.positions) for each in objects))
        numbers.append(wanted)
        objects.append(_recording(geometry, used, faces, material))
    among = torch.cat(numbers)
    ascending = among.argsort()
    return Scene([*objects, *_others(geometry)]), torch.cat(rows)[ascending], among[ascending]


def receivers_of(transfer: Transfer, chosen: Int64[Tensor, "v"]) -> Transfer:
    """The transfer of those of its receivers alone that `chosen` numbers, each once, in that order, without faces."""
    place = torch.full((transfer.vertices,), -1)
    place[chosen] = torch.arange(len(chosen))
    layers = {}
    for name, layer in transfer.layers.items():
        places = place[layer.index(transfer.vertices).long()]
        kept = torch.nonzero(places >= 0)[:, 0]
        kept = kept[places[kept].argsort()]
        layers[name] = layer.take(kept, places[kept])
    vertices = Vertices(
        positions=transfer.positions[chosen], normals=transfer.normals[chosen], faces=transfer.faces[:0]
    )
    return dataclasses.replace(transfer, receivers=vertices, layers=layers)


def sample_transfer(transfer: Transfer, chosen: Int[Tensor, "g"]) -> Transfer:
    """The last layer alone, of those of its receivers that `chosen` numbers, of specular weight 1.

    A receiver may be chosen more than once. Raises InputError if `chosen` names one that there is not.
    """
    name, layer = list(transfer.layers.items())[-1]
    check_chosen(chosen, layer.signal.shape[0])
    rows = layer.index(transfer.vertices)[chosen]
    taken = layer.take(chosen, None)
    return dataclasses.replace(
        transfer,
        receivers=Vertices(
            positions=transfer.positions[rows], normals=transfer.normals[rows], faces=transfer.faces[:0]
        ),
        layers={name: taken.replace(**{layer.weight_name: torch.ones(1, 1)})},
    )


def check_chosen(chosen: Tensor, count: int) -> None:
    """Raises InputError if `chosen` names a glossy receiver that there is not."""
    outside = chosen[(chosen < 0) | (chosen >= count)]
    if len(outside):
        raise InputError(f"chosen names the glossy receiver {int(outside[0])}: there are {count}, numbered from 0")


def _drawn(among: int, count: int, seed: int) -> Int64[Tensor, "count"]:
    return torch.randperm(among, generator=torch.Generator().manual_seed(seed))[:count]


def _corners_of(geometry: Geometry, faces: Tensor) -> tuple[Int64[Tensor, "v"], Int64[Tensor, "F 3"]]:
    """The receivers at the corners of these faces, ascending, and the faces over them."""
    used, corners = torch.unique(geometry.display_faces[torch.unique(faces)], return_inverse=True)
    return used, corners


def _others(geometry: Geometry) -> list[Object]:
    """All surfaces: black but for the mirrors."""
    black = geometry.faces[geometry.mirror < 0]
    found = []
    if len(black):
        found.append(Object(make_mesh(geometry.positions, black, name="all surfaces"), Material(0.0), "blocker"))
    for number, share in enumerate(geometry.reflectance):
        faces = geometry.faces[geometry.mirror == number]
        mesh = make_mesh(geometry.positions, faces, normals=geometry.mirror_normals, name="mirror")
        found.append(Object(mesh, Material(mirror=share)))
    return found


def _recording(geometry: Geometry, used: Tensor, faces: Tensor, material: Material) -> Object:
    tangents = torch.zeros_like(geometry.receiver_normals)
    tangents[geometry.glossy] = geometry.tangents
    mesh = make_mesh(
        geometry.receiver_positions[used],
        faces,
        normals=geometry.receiver_normals[used],
        tangents=tangents[used],
        name="receivers",
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EnergyWarning)
        return Object(mesh, material)
