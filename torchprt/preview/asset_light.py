"""A glTF file under a light, in colours that every viewer shows."""

from __future__ import annotations

import copy
import os
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.preview.asset import UNLIT, Primitive, add_others, keep, numbers
from torchprt.preview.asset_file import AssetFile
from torchprt.preview.asset_map import save_mapped_glb
from torchprt.preview.asset_source import Asset, find_asset
from torchprt.preview.glb import save_glb
from torchprt.scene.gltf import Piece, whole
from torchprt.scene.surface import read_surface
from torchprt.transfer import Transfer

LEAST = 0.02
"""Where a texture has less of a colour than this, light on it is divided by this much, and shows too dark."""
VARIANTS = "KHR_materials_variants"
GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"


def save_lit_glb(
    transfer: Transfer,
    colours: Float[Tensor, "V 3"],
    path: str | os.PathLike[str],
    *,
    given: str | os.PathLike[str] | None = None,
    near: str | os.PathLike[str] = ".",
) -> str:
    """Writes what `transfer` was recorded at in `colours`, linear RGB in its order, as `.glb` that any viewer shows.

    If it was baked from a glTF file that is still there (or in the folder `near`, or is `given`), it is that file as
    `keep_light` makes it, else a plain mesh as `save_glb` writes; of an atlas what `save_mapped_glb` writes. Returns a
    sentence that says which.
    Raises InputError for a volume, if the file is damaged or `path` cannot be written.
    """
    if not transfer.receivers.on_surface:
        raise InputError("a volume has no surface that a .glb could hold: write a picture of it")
    if transfer.receivers.surface_uv is not None:
        return save_mapped_glb(transfer, colours, path, given=given, near=near)
    asset, why = find_asset(transfer, given, near)
    if asset is None:
        save_glb(transfer.positions, transfer.normals, transfer.faces, path, colour=colours)
        return why
    file, over = keep_light(asset, transfer, colours)
    file.save(path)
    if over > 1:
        why += f"; COLOR_0 reaches {over:.3g} where textures are dark, and viewers that stop at 1 show less there"
    return why


def keep_light(asset: Asset, transfer: Transfer, colours: Float[Tensor, "V 3"]) -> tuple[AssetFile, float]:
    """The asset under a light: any viewer shows `colours`, linear RGB of all receivers. Also its brightest COLOR_0.

    Its materials become unlit (KHR_materials_unlit) and white but for their textures, so a viewer shows texture x
    COLOR_0, and COLOR_0 is the colour over that of the texture around the vertex (but never over less than LEAST):
    the mean of what is shown there is the colour. The reverse side of a surface that recorded on both is a primitive
    of its own, which faces the other way. What else was recorded follows as plain meshes.

    COLOR_0 is above 1 where a colour is brighter than the texture, which the standard does not allow and three.js and
    Blender show.
    """
    ordered = transfer.receivers.in_mesh_order(colours)
    drawn = _Lit(numbers(ordered), texture_means(asset), asset.front.start)
    file = keep(asset, drawn)
    add_others(file, asset, transfer, {"COLOR_0": ordered}, {})
    return file, drawn.brightest


def texture_means(asset: Asset) -> Float[np.ndarray, "V 3"]:
    """What the base colour texture is around each vertex of the asset, linear; 1 where there is none."""
    surface = read_surface(asset.document.source)
    # Factors and vertex colours left out: the file that is written has neither.
    plain = tuple(replace(paint, colour=None) for paint in surface.paints)
    with whole(asset.document.source):
        return replace(surface, paints=plain, raw=surface.raw._replace(tint=None)).look(gloss=False).diffuse


class _Lit:
    """Makes primitives unlit, with `colours` over `base`, what their textures are around their vertices, in COLOR_0.

    `start` is the first row of the asset among `colours`; the first of `base` is its own.
    """

    def __init__(self, colours: Float[np.ndarray, "V 3"], base: Float[np.ndarray, "v 3"], start: int) -> None:
        self.colours = colours
        self.base = np.maximum(base, LEAST)
        self.start = start
        self.brightest = 0.0
        self._unlit: dict[tuple[int | None, bool], int] = {}

    def __call__(
        self, file: AssetFile, piece: Piece, entry: Primitive, front: slice, back: np.ndarray | None
    ) -> list[Primitive]:
        file.extend(UNLIT)
        entry["material"] = self._material(file, entry.get("material"), back is not None)
        # A viewer that offers variants would put lit materials back.
        entry.get("extensions", {}).pop(VARIANTS, None)
        base = self.base[front.start - self.start : front.stop - self.start]
        sides = [(entry, self.colours[front])]
        if back is not None:
            sides.append((_reverse(file, piece, entry, back), self.colours[back]))
        for each, colours in sides:
            values = (colours / base).astype("<f4")
            self.brightest = max(self.brightest, float(values.max(initial=0)))
            if piece.colours is not None and piece.colours.shape[1] == 4:
                values = np.concatenate([values, piece.colours[:, 3:].astype("<f4")], axis=1)
            each["attributes"]["COLOR_0"] = file.accessor(values)
        return [each for each, _ in sides]

    def _material(self, file: AssetFile, number: int | None, single: bool) -> int:
        """A copy of a material that shows its texture as it is, from the front alone if it is `single`."""
        if (number, single) not in self._unlit:
            material = {} if number is None else copy.deepcopy(file.tree["materials"][number])
            extensions = material.get("extensions", {})
            core = material.get("pbrMetallicRoughness", {})
            old = extensions.pop(GLOSSINESS, None)
            if old is not None:
                core = {"baseColorFactor": old.get("diffuseFactor", [1, 1, 1, 1])}
                core |= {"baseColorTexture": old["diffuseTexture"]} if "diffuseTexture" in old else {}
            core["baseColorFactor"] = [1, 1, 1, core.get("baseColorFactor", [1, 1, 1, 1])[3]]
            material |= {"pbrMetallicRoughness": core, "extensions": {**extensions, UNLIT: {}}}
            if single:
                material["doubleSided"] = False
            self._unlit[number, single] = file.add("materials", material)
        return self._unlit[number, single]


def _reverse(file: AssetFile, piece: Piece, entry: Primitive, back: np.ndarray) -> Primitive:
    """The same, seen from the other side, where that was recorded."""
    faces = (piece.faces if piece.mirrored else piece.faces[:, ::-1])[(back[piece.faces] >= 0).all(axis=1)]
    indices = file.accessor(faces.reshape(-1, 1).astype("<u4"), indices=True)
    result = {**copy.deepcopy(entry), "indices": indices, "mode": 4}
    # Of no use without light, and of the first side.
    for names in (result["attributes"], *result.get("targets", ())):
        names.pop("NORMAL", None)
        names.pop("TANGENT", None)
    return result
