"""A glTF file as it was, with what was computed at its vertices as further attributes."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.preview.asset_file import AssetFile
from torchprt.preview.asset_source import Asset, objects_of
from torchprt.preview.glb import PLAIN, unit_normals
from torchprt.scene.gltf import INSTANCING, Nodes, Piece
from torchprt.transfer import Transfer

UNLIT = "KHR_materials_unlit"
Values = Mapping[str, Float[Tensor, "V width"]]
Primitive = dict[str, Any]
Drawn = Callable[[AssetFile, Piece, Primitive, slice, np.ndarray | None], list[Primitive]]
"""What becomes of a primitive whose vertices are these rows, and their reverse sides those, or -1."""


def keep(asset: Asset, primitives: Drawn, extras: Mapping[str, Any] | None = None) -> AssetFile:
    """All of the asset, each primitive that was baked made into `primitives`; its meshes get `extras` besides theirs.

    Nodes, materials, textures, names, cameras, animations and extras stay as they are. Where several nodes show one
    mesh, each gets a mesh of its own, because what was computed differs; EXT_mesh_gpu_instancing becomes nodes. Nodes
    that were not baked, of another scene, keep the mesh as it was.
    """
    file = AssetFile(asset.document)
    nodes = Nodes(asset.document)
    meshes = file.tree["meshes"]
    originals = copy.deepcopy(meshes)
    shown = {piece.node for piece in asset.pieces}
    entries = enumerate(asset.document.all("nodes"))
    # A mesh that something else shows too must stay.
    taken = {node["mesh"] for number, node in entries if "mesh" in node and number not in shown}
    of: dict[tuple[int | None, int], int] = {}
    drawn: dict[tuple[int, int], list[Primitive]] = {}
    for piece, front, back in asset.rows():
        place = (piece.node, piece.instance)
        if place not in of:
            of[place] = piece.mesh
            if piece.mesh in taken:
                of[place] = file.add("meshes", copy.deepcopy(originals[piece.mesh]))
            taken.add(piece.mesh)
            _show(file, nodes, *place, of[place])
        entry = copy.deepcopy(originals[piece.mesh]["primitives"][piece.primitive])
        drawn[of[place], piece.primitive] = primitives(file, piece, entry, front, back)
    for mesh in of.values():
        old = meshes[mesh]["primitives"]
        new = [drawn.get((mesh, number), [entry]) for number, entry in enumerate(old)]
        meshes[mesh]["primitives"] = [each for one in new for each in one]
        if extras:
            said = meshes[mesh].get("extras", {})
            # Any JSON is allowed there.
            meshes[mesh]["extras"] = {**(said if isinstance(said, dict) else {"extras": said}), **extras}
    if not any(INSTANCING in node.get("extensions", {}) for node in file.tree.get("nodes", ())):
        keys = ("extensionsUsed", "extensionsRequired")
        file.require(*([name for name in file.tree.get(key, ()) if name != INSTANCING] for key in keys))
    _move(file, asset.place)
    return file


def _show(file: AssetFile, nodes: Nodes, node: int | None, instance: int, mesh: int) -> None:
    """Lets the node show the mesh: itself, or a new child for each of its instances."""
    if node is None:
        show(file, file.add("nodes", {"mesh": mesh}))
        return
    entry = file.tree["nodes"][node]
    if INSTANCING not in file.document.all("nodes")[node].get("extensions", {}):
        entry["mesh"] = mesh
        return
    entry.pop("mesh", None)
    entry.get("extensions", {}).pop(INSTANCING, None)
    if not entry.get("extensions", True):
        del entry["extensions"]
    matrix = nodes.offsets(node)[instance].T.ravel().tolist()
    child = file.add("nodes", {"mesh": mesh, "matrix": matrix})
    entry.setdefault("children", []).append(child)


def _move(file: AssetFile, place: np.ndarray) -> None:
    """Everything in one more node, if the bake had it elsewhere than the file has."""
    if np.array_equal(place, np.eye(4)) or not file.tree.get("scenes"):
        return
    scene = file.tree["scenes"][file.tree.get("scene", 0)]
    scene["nodes"] = [file.add("nodes", {"children": scene["nodes"], "matrix": place.T.ravel().tolist()})]


def keep_attributes(asset: Asset, transfer: Transfer, values: Values, extras: Mapping[str, Any]) -> AssetFile:
    """The asset with `values` of all receivers as attributes, those of reverse sides as _PRT_BACK instead of _PRT.

    What else was recorded follows as plain meshes.
    """
    ordered = {name: transfer.receivers.in_mesh_order(value) for name, value in values.items()}
    arrays = {name: numbers(value) for name, value in ordered.items()}

    def drawn(
        file: AssetFile, piece: Piece, entry: Primitive, front: slice, back: np.ndarray | None
    ) -> list[Primitive]:
        for name, array in arrays.items():
            entry["attributes"][name] = file.accessor(array[front])
            if back is not None:
                reverse = np.where(back[:, None] < 0, 0, array[back]).astype("<f4")
                entry["attributes"][name.replace("_PRT", "_PRT_BACK", 1)] = file.accessor(reverse)
        return [entry]

    file = keep(asset, drawn, extras)
    add_others(file, asset, transfer, ordered, extras)
    return file


def add_others(file: AssetFile, asset: Asset, transfer: Transfer, values: Values, extras: Mapping[str, Any]) -> None:
    """Meshes of what else was recorded, plain and unlit, with `values` in the order of the mesh as attributes."""
    receivers = transfer.receivers
    places = {"POSITION": transfer.positions, "NORMAL": unit_normals(transfer.normals)}
    arrays = {name: numbers(receivers.in_mesh_order(value)) for name, value in places.items()}
    arrays |= {name: numbers(value) for name, value in values.items()}
    order = receivers.in_mesh_order(torch.arange(transfer.vertices, dtype=torch.float64)[:, None])[:, 0].long()
    faces = order.argsort()[transfer.faces.long().cpu()].numpy()
    kept = {asset.front.start, -1 if asset.back is None else int(asset.back[asset.back >= 0].min(initial=len(order)))}
    for each in (each for each in objects_of(transfer) if each["rows"][0] not in kept):
        first, end = each["rows"]
        name, rows = Path(each["name"]).name, slice(first, end)
        inside = ((faces >= first) & (faces < end)).all(axis=1)
        attributes = {key: file.accessor(array[rows], bounds=key == "POSITION") for key, array in arrays.items()}
        indices = file.accessor((faces[inside] - first).reshape(-1, 1).astype("<u4"), indices=True)
        material = file.add("materials", {**PLAIN, "name": name})
        file.extend(UNLIT)
        primitive = {"attributes": attributes, "indices": indices, "material": material}
        mesh = file.add("meshes", {"name": name, "primitives": [primitive], **({"extras": extras} if extras else {})})
        show(file, file.add("nodes", {"mesh": mesh, "name": name}))


def show(file: AssetFile, node: int) -> None:
    """Puts a node into the default scene."""
    if not file.tree.get("scenes"):
        file.tree["scene"] = file.add("scenes", {"nodes": []})
    scene = file.tree["scenes"][file.tree.get("scene", 0)]
    scene["nodes"] = [*scene.get("nodes", ()), node]


def numbers(values: Tensor) -> np.ndarray:
    """As accessors have them: little-endian float32."""
    found: np.ndarray = values.detach().cpu().float().numpy().astype("<f4")
    return found
