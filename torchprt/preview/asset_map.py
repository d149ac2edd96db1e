"""What was recorded at texels as a model that any viewer shows: the lit map on texture coordinates of its own."""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.preview.asset import UNLIT, Primitive, keep, numbers, show
from torchprt.preview.asset_file import AssetFile
from torchprt.preview.asset_source import Asset, find_asset
from torchprt.preview.encode import encoded, image_of
from torchprt.preview.glb import unit_normals
from torchprt.scene.gltf import Document, Piece
from torchprt.shade import srgb
from torchprt.transfer import Atlas, Transfer, Vertices, diffuse_transfer

EMPTY = b'{"asset": {"version": "2.0"}}'
LINEAR, CLAMP = 9729, 33071
"""Of the specification of glTF 2.0: filters and wrapping of samplers. No mip levels: they would mix charts."""
OWN = ("name", "doubleSided", "extras")
"""What an unlit copy of a material keeps of it."""


def save_mapped_glb(
    transfer: Transfer,
    colours: Float[Tensor, "V 3"],
    path: str | os.PathLike[str],
    *,
    given: str | os.PathLike[str] | None = None,
    near: str | os.PathLike[str] = ".",
) -> str:
    """Writes what an atlas lies on, with the map of `colours`, linear RGB in [0, 1], as `.glb` that any viewer shows.

    The map is a PNG of 8 bits in sRGB, `baseColorTexture` of materials that are unlit (KHR_materials_unlit), on the set
    of texture coordinates that it was baked on if that is not the first, else on one that follows those of the file, at
    least TEXCOORD_1. Vertices at seams of the map are split.
    If it was baked from a glTF file that is still there (or in the folder `near`, or is `given`), all else is as that
    file has it; what else was baked, or everything, follows as plain meshes, whose TEXCOORD_0 is the map too. Vertex
    colours are left out, which viewers would multiply with the map. Returns a sentence that says which.
    Raises InputError if the transfer is of no atlas, `given` does not fit or `path` cannot be written.
    """
    atlas = transfer.receivers.as_atlas()
    asset, why = find_asset(_surface(atlas), given, near)
    if asset is not None and not _same_faces(asset, atlas):
        why = f"a plain mesh, as {asset.document.source} has other faces than were baked"
        asset = None
    picture = encoded(image_of(srgb(atlas.image(colours.float().cpu()))), format="PNG")
    drawn = _Mapped(picture, atlas, asset)
    file = AssetFile(Document(EMPTY, "plain.gltf")) if asset is None else keep(asset, drawn)
    for each in _objects(atlas):
        if asset is None or each["vertices"][0] != asset.front.start:
            drawn.add(file, each)
    file.save(path)
    return f"{why}; the map is on TEXCOORD_{drawn.highest}"


def _objects(atlas: Atlas) -> Sequence[dict[str, Any]]:
    """What the map lies on, mesh by mesh."""
    everything = {"vertices": [0, len(atlas.mesh_positions)], "faces": [0, len(atlas.mesh_faces)]}
    return list(atlas.objects) or [{"name": "", "role": "receiver", **everything}]


def _surface(atlas: Atlas) -> Transfer:
    """The meshes of the map as if they had been recorded at vertices, which files are compared with."""
    objects = [
        {"name": each["name"], "role": each["role"], "side": "front", "rows": each["vertices"]}
        for each in _objects(atlas)
    ]
    count = len(atlas.mesh_positions)
    found = diffuse_transfer(torch.zeros(1, 1, count), torch.zeros(1, 1), *atlas.surface)
    receivers = found.receivers.replace(objects=objects)
    assert isinstance(receivers, Vertices)
    return Transfer(receivers=receivers, layers=found.layers)


def _faces_of(atlas: Atlas, asset: Asset) -> slice:
    """Those of the mesh that an asset is."""
    return next(slice(*each["faces"]) for each in _objects(atlas) if each["vertices"][0] == asset.front.start)


def _same_faces(asset: Asset, atlas: Atlas) -> bool:
    """Whether the faces of the file are those that the map knows of."""
    there = atlas.mesh_faces[_faces_of(atlas, asset)].numpy()
    here = [piece.faces + rows.start for piece, rows, _ in asset.rows()]
    return np.array_equal(np.concatenate([np.zeros((0, 3), np.int64), *here]), there)


class _Mapped:
    """Makes primitives show the map: `picture` is its PNG."""

    def __init__(self, picture: bytes, atlas: Atlas, asset: Asset | None) -> None:
        self.picture = picture
        self.atlas = atlas
        self.uv = atlas.surface_uv.numpy().astype("<f4")
        self.highest = 1
        self._next = 0 if asset is None else _faces_of(atlas, asset).start
        self._texture: int | None = None
        self._plain: Document | None = None
        self._unlit: dict[tuple[int | None, int], int] = {}

    def __call__(
        self, file: AssetFile, piece: Piece, entry: Primitive, front: slice, back: np.ndarray | None
    ) -> list[Primitive]:
        faces, uv = piece.faces, self.uv[self._next : self._next + len(piece.faces)]
        self._next += len(faces)
        if piece.mirrored:
            faces, uv = faces[:, ::-1], uv[:, ::-1]
        there = next((number for number in sorted(piece.uv) if number and _same_uv(piece.uv[number], faces, uv)), None)
        vertex, corners, places = split(faces, uv)
        if there is not None:
            # The set that it was baked on. A second copy would be a third set, which some engines do not have.
            self.highest = max(self.highest, there)
        elif len(vertex) == len(np.unique(vertex)):
            whole = np.zeros((len(piece.positions), 2), "<f4")
            whole[vertex] = places
            places = whole
        else:
            self._take(file, entry, vertex)
            entry["indices"], entry["mode"] = file.accessor(corners.reshape(-1, 1).astype("<u4"), indices=True), 4
        attributes = entry["attributes"]
        for name in [each for each in attributes if each.startswith("COLOR_")]:
            del attributes[name]
        number = self._put(file, attributes, places) if there is None else there
        entry["material"] = self._material(file, entry.get("material"), number)
        # A viewer that offers variants would put lit materials back.
        entry.get("extensions", {}).pop("KHR_materials_variants", None)
        return [entry]

    def add(self, file: AssetFile, each: dict[str, Any]) -> None:
        """A mesh of the map as a plain one."""
        faces = slice(*each["faces"])
        vertex, corners, places = split(self.atlas.mesh_faces[faces].numpy().astype(np.int64), self.uv[faces])
        if not len(corners):
            return
        attributes = {
            "POSITION": file.accessor(numbers(self.atlas.mesh_positions)[vertex], bounds=True),
            "NORMAL": file.accessor(numbers(unit_normals(self.atlas.mesh_normals))[vertex]),
        }
        number = self._put(file, attributes, places)
        name = Path(each["name"]).name
        primitive = {
            "attributes": attributes,
            "indices": file.accessor(corners.reshape(-1, 1).astype("<u4"), indices=True),
            "material": self._material(file, None, number),
        }
        mesh = file.add("meshes", {"name": name, "primitives": [primitive]})
        show(file, file.add("nodes", {"mesh": mesh, "name": name}))

    def _put(self, file: AssetFile, attributes: dict[str, int], places: Float[np.ndarray, "v 2"]) -> int:
        """The number of the set of texture coordinates that these become: at least 1, and none before it is missing."""
        number = 0
        while f"TEXCOORD_{number}" in attributes:
            number += 1
        accessor = file.accessor(places.astype("<f4"))
        attributes[f"TEXCOORD_{number}"] = accessor
        if number == 0:
            number = 1
            attributes["TEXCOORD_1"] = accessor
        self.highest = max(self.highest, number)
        return number

    def _take(self, file: AssetFile, entry: Primitive, vertex: Int[np.ndarray, "v"]) -> None:
        """Repeats vertices in all attributes, and in those of morph targets."""
        if self._plain is None:
            self._plain = Document(file.content(), file.document.source)
            for each in self._plain.all("accessors"):
                # As they stand in the file.
                each.pop("normalized", None)
        for names in (entry["attributes"], *entry.get("targets", ())):
            for name, number in names.items():
                if name.startswith("COLOR_"):
                    continue
                old = file.tree["accessors"][number]
                names[name] = file.accessor(self._plain.accessor(number)[vertex], bounds=name == "POSITION")
                if old.get("normalized"):
                    file.tree["accessors"][names[name]]["normalized"] = True

    def _material(self, file: AssetFile, number: int | None, coordinates: int) -> int:
        """A copy of a material that shows the map as it is."""
        file.extend(UNLIT)
        if self._texture is None:
            sampler = {"magFilter": LINEAR, "minFilter": LINEAR, "wrapS": CLAMP, "wrapT": CLAMP}
            image = file.picture(self.picture, "image/png")
            self._texture = file.add("textures", {"source": image, "sampler": file.add("samplers", sampler)})
        if (number, coordinates) not in self._unlit:
            old = {} if number is None else file.tree["materials"][number]
            core = {
                "baseColorTexture": {"index": self._texture, "texCoord": coordinates},
                "metallicFactor": 0,
                "roughnessFactor": 1,
            }
            material = {key: copy.deepcopy(old[key]) for key in OWN if key in old}
            material |= {"pbrMetallicRoughness": core, "extensions": {UNLIT: {}}}
            self._unlit[number, coordinates] = file.add("materials", material)
        return self._unlit[number, coordinates]


def _same_uv(values: Float[np.ndarray, "V 2"], faces: Int[np.ndarray, "F 3"], uv: Float[np.ndarray, "F 3 2"]) -> bool:
    """Whether a set of texture coordinates of a file is what its faces have on the map."""
    return np.array_equal(values[faces].astype("<f4"), uv)


def split(
    faces: Int[np.ndarray, "F 3"], uv: Float[np.ndarray, "F 3 2"]
) -> tuple[Int[np.ndarray, "v"], Int[np.ndarray, "F 3"], Float[np.ndarray, "v 2"]]:
    """Vertices that have one place on the map each: which vertex each was, ascending; faces of them; their places."""
    key = np.concatenate([faces.reshape(-1, 1).astype(np.float64), uv.reshape(-1, 2)], axis=1)
    found, number = np.unique(key, axis=0, return_inverse=True)
    return found[:, 0].astype(np.int64), number.reshape(-1, 3), found[:, 1:]
