"""Where the faces of a scene are on one map: which texture coordinates are taken, and what is wrong with them."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Float64, Int, Int64
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from torchprt.errors import InputError
from torchprt.words import count

from .object import Object
from .rasterise import rasterise
from .unwrap import pack, unwrap
from .weld import weld

# The share of covered texels that may lie in several faces, as rounding along edges makes them.
OVERLAP = 1e-3
# A ground is eight times as wide as what stands on it, and coarser outward: the side of its chart is that much smaller.
GROUND = 0.25
MADE = "charts are made by xatlas"


class AtlasWarning(UserWarning):
    """Texture coordinates that a map cannot show as they are."""


@dataclass(frozen=True, eq=False)
class Charts:
    """Where the faces of every object of a scene are on one map.

    - `uv`: of each object, [F, 3, 2] in [0, 1], v down; NaN for faces that are not on the map.
    - `chart`: of each object, [F], which of its charts every face is of, from 0; a chart is what hangs together on the
      map as on the surface.
    - `notes`: what was decided and mended, in sentences.
    """

    uv: list[Float64[Tensor, "_ 3 2"]]
    chart: list[Int64[Tensor, "_"]]
    notes: tuple[str, ...]


def charts_of(
    objects: Sequence[Object], uv: int | Literal["unwrap"] | None, rows: int, columns: int, gutter: int
) -> Charts:
    """The charts of all objects that receive, on a map of `rows` x `columns`.

    `uv` is a set of texture coordinates, "unwrap" for charts by xatlas, or None: set 1 if every object has it, as
    lightmaps do, else set 0, where it is fit; else unwrapped. Fit are coordinates within the square, of every face,
    that put no two faces at one place, also not of two objects. Those of objects that are fit alone and lie on each
    other are packed side by side, each as large as it is on the surface.
    Charts that lie beside the square by whole numbers are brought back.

    Warns (`AtlasWarning`) if a set that was asked for puts several faces at one place.
    Raises InputError if a set that was asked for is missing or leaves the square, or as `pack`.
    """
    receiving = [each for each in objects if each.receives]
    if uv == "unwrap":
        found, notes = _unwrapped(receiving, rows, columns, gutter, "as asked")
    elif uv is not None:
        found, notes = _given(receiving, uv, rows, columns, gutter)
    else:
        found, notes = _decided(receiving, rows, columns, gutter)
    own = iter(found)
    all_uv = [next(own) if each.receives else np.full((len(each.mesh.faces), 3, 2), np.nan) for each in objects]
    chart = [_pieces(each, pairs) for each, pairs in zip(objects, all_uv, strict=True)]
    mirrored = sum(_mirrored(pairs) for pairs in all_uv)
    if mirrored and not notes[0].startswith(MADE):
        notes.append(f"{count(mirrored, 'face')} lie mirrored on the map")
    return Charts([torch.from_numpy(each) for each in all_uv], [torch.from_numpy(each) for each in chart], tuple(notes))


def _unwrapped(
    objects: Sequence[Object], rows: int, columns: int, gutter: int, why: str
) -> tuple[list[np.ndarray], list[str]]:
    parts, flat = [], 0
    for each in objects:
        pairs = unwrap(each.mesh.positions.numpy(), each.mesh.faces.numpy(), each.mesh.name)
        parts.append(pairs * (GROUND if each.role == "ground" else 1.0))
        flat += int(np.isnan(pairs).any(axis=(1, 2)).sum())
    found = pack(parts, rows, columns, gutter)
    notes = [f"{MADE}, {why}"]
    if any(each.role == "ground" for each in objects):
        notes.append(f"the ground has 1/{1 / GROUND:.0f} of the texels along a length that the rest has")
    if flat:
        notes.append(f"{count(flat, 'face')} without area are on no chart")
    return found, notes


def _given(
    objects: Sequence[Object], number: int, rows: int, columns: int, gutter: int
) -> tuple[list[np.ndarray], list[str]]:
    """A set of texture coordinates as it is."""
    found, notes = _sets(objects, number)
    for each, pairs in zip(objects, found, strict=True):
        outside = _outside(pairs)
        if outside:
            raise InputError(
                f"{each.mesh.name}: {count(outside, 'face')} of set {number} of the texture coordinates leave the "
                "square from 0 to 1: give another set, or --uv unwrap"
            )
    faulty = [each for each, pairs in zip(objects, found, strict=True) if _overlap([pairs], rows, columns) > OVERLAP]
    if faulty:
        share = max(_overlap([pairs], rows, columns) for pairs in found)
        warnings.warn(
            f"{', '.join(each.mesh.name for each in faulty)}: set {number} of the texture coordinates puts several "
            f"faces at one place, on {share:.1%} of the texels; the first of them shows there on all: use --uv unwrap",
            AtlasWarning,
            stacklevel=2,
        )
    elif len(objects) > 1 and _overlap(found, rows, columns) > OVERLAP:
        return _side_by_side(objects, found, number, rows, columns, gutter, notes)
    return found, notes


def _side_by_side(
    objects: Sequence[Object],
    found: Sequence[np.ndarray],
    number: int,
    rows: int,
    columns: int,
    gutter: int,
    notes: list[str],
) -> tuple[list[np.ndarray], list[str]]:
    parts = [pairs * _unit(each, pairs) for each, pairs in zip(objects, found, strict=True)]
    said = f"set {number} of the texture coordinates of {count(len(objects), 'object')}, packed side by side"
    return pack(parts, rows, columns, gutter), [said, *notes[1:]]


def _decided(objects: Sequence[Object], rows: int, columns: int, gutter: int) -> tuple[list[np.ndarray], list[str]]:
    """The first set that is fit, else charts made anew; and why."""
    reasons = []
    for number in (1, 0):
        missing = [each.mesh.name for each in objects if number not in each.mesh.uv_sets]
        if missing:
            reasons.append(f"{Path(missing[0]).name} has no set {number}" if number == 0 else "")
            continue
        found, notes = _sets(objects, number)
        reason = _unfit(objects, found, rows, columns)
        if reason:
            reasons.append(f"set {number} {reason}")
        elif len(objects) > 1 and _overlap(found, rows, columns) > OVERLAP:
            return _side_by_side(objects, found, number, rows, columns, gutter, notes)
        else:
            return found, notes
    return _unwrapped(objects, rows, columns, gutter, "because " + " and ".join(each for each in reasons if each))


def _unfit(objects: Sequence[Object], found: Sequence[np.ndarray], rows: int, columns: int) -> str:
    for pairs in found:
        lost, outside = int(np.isnan(pairs).any(axis=(1, 2)).sum()), _outside(pairs)
        share = 0.0 if outside else _overlap([pairs], rows, columns)
        if lost:
            return f"lacks {count(lost, 'face')}"
        if outside:
            return f"leaves the square with {count(outside, 'face')}"
        if share > OVERLAP:
            return f"puts several faces at one place on {share:.1%} of the texels"
        flat = int((_signed(pairs) == 0).sum())
        if flat > 0.5 * len(pairs):
            return f"gives no area to {count(flat, 'face')}"
    return ""


def _sets(objects: Sequence[Object], number: int) -> tuple[list[np.ndarray], list[str]]:
    """A set of texture coordinates, charts that lie beside the square brought back."""
    found, moved = [], 0
    for each in objects:
        pairs = each.mesh.uv_set(number).numpy().copy()
        pairs[np.isnan(pairs).any(axis=(1, 2))] = np.nan
        piece = _pieces(each, pairs)
        low = np.full((int(piece.max(initial=-1)) + 1, 2), np.inf)
        known = ~np.isnan(pairs).any(axis=(1, 2))
        np.minimum.at(low, piece[known], pairs[known].min(axis=1))
        whole = np.floor(np.where(np.isfinite(low), low, 0.0) + 1e-6)
        moved += int((whole != 0).any(axis=1).sum())
        found.append(pairs - whole[piece][:, None])
    notes = [f"set {number} of the texture coordinates"]
    if moved:
        notes.append(f"{count(moved, 'chart')} beside the square are brought back by whole numbers")
    lost = sum(int(np.isnan(pairs).any(axis=(1, 2)).sum()) for pairs in found)
    if lost:
        notes.append(f"{count(lost, 'face')} without texture coordinates are on no chart")
    return found, notes


def _outside(pairs: Float[np.ndarray, "F 3 2"]) -> int:
    with np.errstate(invalid="ignore"):
        result: int = int(((pairs < -1e-6) | (pairs > 1 + 1e-6)).any(axis=(1, 2)).sum())
    return result


def _overlap(parts: Sequence[Float[np.ndarray, "_ 3 2"]], rows: int, columns: int) -> float:
    """The share of covered texels with a place in several faces."""
    pairs = np.concatenate(list(parts))
    # Finer than some hundred texels nothing more is seen of it.
    rows, columns = min(rows, 1024), min(columns, 1024)
    raster = rasterise(pairs, np.zeros(len(pairs), np.int64), rows, columns, 2)
    return raster.twice / max(len(raster.texel), 1)


def _signed(pairs: Float[np.ndarray, "F 3 2"]) -> Float[np.ndarray, "F"]:
    one, other = pairs[:, 1] - pairs[:, 0], pairs[:, 2] - pairs[:, 0]
    result: np.ndarray = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return result


def _mirrored(pairs: Float[np.ndarray, "F 3 2"]) -> int:
    """Faces that are wound the other way on the map; v is down, so a face seen from outside turns the other way."""
    with np.errstate(invalid="ignore"):
        result: int = int((_signed(pairs) > 0).sum())
    return result


def _unit(object: Object, pairs: Float[np.ndarray, "F 3 2"]) -> float:
    """How many units of length a unit of its texture coordinates is, in the mean over its faces."""
    corners = object.mesh.positions.numpy()[object.mesh.faces.numpy()]
    known = ~np.isnan(pairs).any(axis=(1, 2))
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)[known].sum()
    flat = np.abs(_signed(pairs[known])).sum()
    return float((area / flat) ** 0.5) if flat > 0 else 1.0


def _pieces(object: Object, pairs: Float[np.ndarray, "F 3 2"]) -> Int[np.ndarray, "F"]:
    """Faces whose corners are at one place both on the surface and on the map hang together."""
    place = weld(object.mesh.positions.numpy())[object.mesh.faces.numpy()].reshape(-1, 1)
    key = np.concatenate([place, pairs.reshape(-1, 2)], axis=1)
    # What is missing is alike, so that it is one chart a piece of surface.
    _, corner = np.unique(np.nan_to_num(key, nan=-1e30), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    size = int(corner.max(initial=-1)) + 1
    ends = (corner.ravel(), np.roll(corner, -1, axis=1).ravel())
    _, label = connected_components(coo_matrix((np.ones(corner.size, bool), ends), (size, size)), directed=False)
    _, number = np.unique(label[corner[:, 0]], return_inverse=True)
    result: np.ndarray = number.reshape(-1).astype(np.int64)
    return result
