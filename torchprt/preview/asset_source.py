"""The glTF file that a transfer was baked from, if it is still there and still the same."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Int

from torchprt.errors import InputError
from torchprt.scene.gltf import Document, Piece, pieces, whole
from torchprt.transfer import Transfer

SUFFIXES = (".glb", ".gltf")
NEAR = 1e-4
"""How far the vertices of a file may be from those of a bake, as a share of the size of the model."""


@dataclass(frozen=True, eq=False)
class Asset:
    """A glTF document, and which receivers of a transfer, in the order of the mesh, are its vertices."""

    document: Document
    pieces: Sequence[Piece]
    front: slice
    """The rows of its vertices, piece after piece."""
    back: Int[np.ndarray, "v"] | None
    """The row of the reverse side of each of them, -1 where it was not recorded; None if it was nowhere."""
    place: Float64[np.ndarray, "4 4"]
    """From the world of the file to that of the bake."""

    def rows(self) -> list[tuple[Piece, slice, Int[np.ndarray, "v"] | None]]:
        """Every piece with the rows of its vertices, and as `back` has them those of their reverse sides."""
        result, start = [], 0
        for piece in self.pieces:
            end = start + len(piece.positions)
            back = None if self.back is None or (self.back[start:end] < 0).all() else self.back[start:end]
            result.append((piece, slice(self.front.start + start, self.front.start + end), back))
            start = end
        return result


def find_asset(
    transfer: Transfer, given: str | os.PathLike[str] | None = None, near: str | os.PathLike[str] = "."
) -> tuple[Asset | None, str]:
    """The glTF file whose vertices `transfer` was recorded at, and in words which it is, or why there is none.

    That is the file `given`, or else the first glTF among what the transfer says it was baked from, under the name
    that it had then or, if it is not there, in the folder `near`. A scene may have moved, turned and scaled it.
    Raises InputError if a file is given that does not fit, or if one is damaged.
    """
    objects = objects_of(transfer)
    fronts = [each for each in objects if each["side"] == "front"]
    if given is not None:
        document, found = _read(given)
        count = sum(len(piece.positions) for piece in found)
        fitting = [each for each in fronts if each["rows"][1] - each["rows"][0] == count]
        if not fitting:
            raise InputError(
                f"{given} has {count} vertices, and the transfer was recorded at {transfer.vertices} others: give the "
                "file that was baked"
            )
        asset = _fit(transfer, document, found, fitting[0], objects)
        if asset is None:
            raise InputError(f"{given} has its vertices elsewhere than the transfer: give the file that was baked")
        return asset, f"keeps what {given} holds"
    named = [each for each in fronts if each["name"].lower().endswith(SUFFIXES)]
    if not named:
        names = list(dict.fromkeys(each["name"] for each in fronts if each["name"]))
        known = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        return None, f"a plain mesh, as {known} is no glTF" if known else "a plain mesh: --source says what was baked"
    name = Path(named[0]["name"])
    path = next((each for each in (name, Path(near) / name.name) if each.is_file()), None)
    if path is None:
        return None, f"a plain mesh, as {name} is not there any more: --source says where it is"
    document, found = _read(path)
    count, wanted = sum(len(piece.positions) for piece in found), named[0]["rows"][1] - named[0]["rows"][0]
    if count != wanted:
        return None, f"a plain mesh, as {path} has {count} vertices and had {wanted} when it was baked"
    asset = _fit(transfer, document, found, named[0], objects)
    if asset is None:
        return None, f"a plain mesh, as the vertices of {path} have moved since it was baked"
    return asset, f"keeps what {path} holds"


def _read(path: str | os.PathLike[str]) -> tuple[Document, list[Piece]]:
    document = Document.read(path)
    with whole(document.source):
        return document, pieces(document).pieces


def objects_of(transfer: Transfer) -> list[dict[str, Any]]:
    """What the receivers are of; of older files that do not say it, one object."""
    objects = list(getattr(transfer.receivers, "objects", ()))
    if objects:
        return objects
    return [{"name": "", "role": "receiver", "side": "front", "rows": [0, transfer.vertices]}]


def _fit(
    transfer: Transfer, document: Document, found: list[Piece], front: dict[str, Any], objects: list[dict[str, Any]]
) -> Asset | None:
    """The asset, if its vertices are those of the rows that `front` names."""
    rows = slice(*front["rows"])
    there = transfer.receivers.in_mesh_order(transfer.positions.double()).cpu().numpy()
    here = np.concatenate([np.zeros((0, 3)), *(piece.positions for piece in found)])
    size = np.ptp(there[rows], axis=0).max(initial=0)
    for place in (np.eye(4), _similarity(here, there[rows])):
        moved = here @ place[:3, :3].T + place[:3, 3]
        if np.abs(moved - there[rows]).max(initial=0) <= NEAR * size:
            return Asset(document, found, rows, _backs(document, found, there, front, objects), place)
    return None


def _backs(
    document: Document,
    found: list[Piece],
    positions: Float64[np.ndarray, "V 3"],
    front: dict[str, Any],
    objects: list[dict[str, Any]],
) -> Int[np.ndarray, "v"] | None:
    """The row of the reverse side of each vertex: of all, or of those that faces of double-sided materials have."""
    # The reverse sides follow in the order of the fronts; one file may be there twice.
    same = [
        [each for each in objects if (each["side"], each["name"]) == (side, front["name"])]
        for side in ("front", "back")
    ]
    number = same[0].index(front)
    if len(same[0]) != len(same[1]):
        return None
    (first, end), (back, last) = front["rows"], same[1][number]["rows"]
    chosen, start = np.zeros(end - first, bool), 0
    for piece in found:
        material = {} if piece.material is None else document.entry("materials", piece.material)
        if material.get("doubleSided"):
            chosen[start + np.unique(piece.faces)] = True
        start += len(piece.positions)
    for some in (np.arange(end - first), np.flatnonzero(chosen)):
        if len(some) == last - back and np.array_equal(positions[first:end][some], positions[back:last]):
            result = np.full(end - first, -1)
            result[some] = np.arange(back, last)
            return result
    return None


def _similarity(here: Float64[np.ndarray, "V 3"], there: Float64[np.ndarray, "V 3"]) -> Float64[np.ndarray, "4 4"]:
    """The scale, turn and shift that bring one set of points nearest to the other.

    Source: Umeyama 1991, Least-squares estimation of transformation parameters between two point patterns.
    """
    a, b = here - here.mean(0), there - there.mean(0)
    u, size, v = np.linalg.svd(b.T @ a)
    # A turn, never a mirror.
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ v)) or 1])
    turn = (u * sign) @ v
    spread = float((a**2).sum())
    scale = float((size * sign).sum()) / spread if spread else 1.0
    place = np.eye(4)
    place[:3, :3] = scale * turn
    place[:3, 3] = there.mean(0) - scale * turn @ here.mean(0)
    return place
