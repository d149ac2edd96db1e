"""A glTF file under a light, in colours that every viewer shows."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from torchprt.preview.asset import UNLIT, Drawn, Primitive, add_others, keep, numbers
from torchprt.preview.asset_file import AssetFile
from torchprt.preview.asset_source import Asset, find_asset
from torchprt.preview.glb import save_glb
from torchprt.scene.gltf import Document, Piece
from torchprt.transfer import Transfer

LEAST = 0.02
"""Where a material has less of a colour than this, light on it is divided by this much, and shows too dark."""
VARIANTS = "KHR_materials_variants"


def save_lit_glb(
    transfer: Transfer,
    colours: Float[Tensor, "V 3"],
    path: str | os.PathLike[str],
    *,
    near: str | os.PathLike[str] = ".",
) -> str:
    """Writes what `transfer` was recorded at in `colours`, linear RGB in its order, as `.glb` that any viewer shows.

    If it was baked from a glTF file that is still there (or in the folder `near`), it is that file as `keep_light`
    makes it, else a plain mesh as `save_glb` writes. Returns a sentence that says which.
    Raises InputError if the file is damaged or `path` cannot be written.
    """
    asset, why = find_asset(transfer, near=near)
    if asset is None:
        save_glb(transfer.positions, transfer.normals, transfer.faces, path, colour=colours)
        return why
    file, over = keep_light(asset, transfer, colours)
    file.save(path)
    if over > 1:
        why += f"; COLOR_0 reaches {over:.3g} where materials are dark, and viewers that stop at 1 show less there"
    return why


def keep_light(asset: Asset, transfer: Transfer, colours: Float[Tensor, "V 3"]) -> tuple[AssetFile, float]:
    """The asset under a light: `colours`, linear RGB of all receivers, are what any viewer shows of it.

    Also the largest number in COLOR_0.
    Its materials become unlit (KHR_materials_unlit), which shows texture x factor x COLOR_0, so COLOR_0 is the colour
    over that of the material there, but never over less than LEAST. The reverse side of a surface that recorded on
    both is a primitive of its own, which faces the other way. What else was recorded follows as plain meshes.
    """
    ordered = transfer.receivers.in_mesh_order(colours)
    largest = [0.0]
    file = keep(asset, _with_colours(ordered, lambda piece: base_colour(asset.document, piece), largest))
    add_others(file, asset, transfer, {"COLOR_0": ordered}, {})
    return file, max(largest)


def _with_colours(
    colours: Float[Tensor, "V 3"], base: Callable[[Piece], Float[np.ndarray, "v 3"]], largest: list[float]
) -> Drawn:
    """Unlit primitives with `colours`, over those that `base` says of the material alone, in COLOR_0.

    The largest number of each goes into `largest`.
    """
    shown = numbers(colours)
    unlit: dict[tuple[int | None, bool], int] = {}

    def drawn(file: AssetFile, piece: Piece, entry: Primitive, front: slice, back: slice | None) -> list[Primitive]:
        divisor = np.maximum(base(piece), LEAST)
        file.extend(UNLIT)
        key = (entry.get("material"), back is not None)
        if key not in unlit:
            unlit[key] = file.add("materials", _unlit(file, *key))
        entry["material"] = unlit[key]
        # A viewer that offers variants would put lit materials back.
        entry.get("extensions", {}).pop(VARIANTS, None)
        result = [entry]
        if back is not None:
            faces = piece.faces if piece.mirrored else piece.faces[:, ::-1]
            indices = file.accessor(faces.reshape(-1, 1).astype("<u4"), indices=True)
            result.append({**copy.deepcopy(entry), "indices": indices, "mode": 4})
            # Of no use without light, and of the other side.
            for names in (result[1]["attributes"], *result[1].get("targets", ())):
                names.pop("NORMAL", None)
                names.pop("TANGENT", None)
        for each, rows in zip(result, (front, back), strict=False):
            assert rows is not None
            values = [(shown[rows] / divisor).astype("<f4")]
            largest.append(float(values[0].max(initial=0)))
            if piece.colours is not None and piece.colours.shape[1] == 4:
                values.append(piece.colours[:, 3:].astype("<f4"))
            each["attributes"]["COLOR_0"] = file.accessor(np.concatenate(values, axis=1))
        return result

    return drawn


def _unlit(file: AssetFile, number: int | None, single: bool) -> dict[str, Any]:
    """A copy of a material that is shown as it is, to be seen from the front alone if it is `single`."""
    material = {} if number is None else copy.deepcopy(file.tree["materials"][number])
    material["extensions"] = {**material.get("extensions", {}), UNLIT: {}}
    if single:
        material["doubleSided"] = False
    return material


def base_colour(document: Document, piece: Piece) -> Float[np.ndarray, "v 3"]:
    material = {} if piece.material is None else document.entry("materials", piece.material)
    factor = material.get("pbrMetallicRoughness", {}).get("baseColorFactor", (1, 1, 1, 1))
    return np.tile(np.asarray(factor[:3], np.float64), (len(piece.positions), 1))
