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
from torch import Tensor

from torchprt.errors import InputError
from torchprt.words import count

from .ground import COARSENING, FINE, REACH
from .object import Object
from .pack import pack
from .rasterise import overlap
from .unwrap import unwrap
from .weld import edges, weld

# The share of covered texels that may lie in several faces, as rounding along edges makes them.
OVERLAP = 1e-3
# Beside what stands on it a ground is of less interest: the side of its chart is that much smaller.
GROUND = 0.5
# In its own sizes: a ground that rises by less is level.
LEVEL = 1e-6
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
    Charts that lie beside the square by whole numbers are brought back. A ground is laid out by `ground_chart`, and
    packed beside the others, unless it has the set that was asked for.

    Warns (`AtlasWarning`) if a set that was asked for puts several faces at one place.
    Raises InputError if a set that was asked for is missing or leaves the square, or as `pack`.
    """
    receiving = [each for each in objects if each.receives]
    apart = [each for each in receiving if each.role == "ground" and (uv is None or uv not in each.mesh.uv_sets)]
    others = [each for each in receiving if each not in apart]
    if uv == "unwrap":
        layout = _unwrapped(others, "as asked")
    elif uv is not None:
        layout = _given(others, uv, rows, columns)
    else:
        layout = _decided(others, rows, columns)
    notes = layout.notes
    if apart:
        layout = layout.to_pack(others, notes)
        grounds = [ground_chart(each, [one for one in objects if one.role != "ground"]) for each in apart]
        layout = _Layout([*layout.parts, *grounds], notes, packed=False)
        notes.append(
            f"the ground has 1/{1 / GROUND:.0f} of the texels along a length that the rest has, and fewer farther away"
        )
    found = layout.parts if layout.packed or not receiving else pack(layout.parts, rows, columns, gutter)
    of = dict(zip(map(id, [*others, *apart]), found, strict=True))
    all_uv = [of.get(id(each), np.full((len(each.mesh.faces), 3, 2), np.nan)) for each in objects]
    notes += _faults([each for each in objects if each.receives], [of[id(each)] for each in objects if each.receives])
    chart = [_pieces(each, pairs) for each, pairs in zip(objects, all_uv, strict=True)]
    return Charts([torch.from_numpy(each) for each in all_uv], [torch.from_numpy(each) for each in chart], tuple(notes))


@dataclass
class _Layout:
    """Charts of objects: `packed`, where they are on the map, else in a unit of length and still to pack."""

    parts: list[np.ndarray]
    notes: list[str]
    packed: bool

    def to_pack(self, objects: Sequence[Object], notes: list[str]) -> _Layout:
        """The same in the unit of length of the objects."""
        if not self.packed:
            return self
        parts = [pairs * _unit(each, pairs) for each, pairs in zip(objects, self.parts, strict=True)]
        return _Layout(parts, notes, packed=False)


def ground_chart(object: Object, standing: Sequence[Object]) -> Float[np.ndarray, "F 3 2"]:
    """One chart for a ground, in a unit of length: seen from above, as fine under and around what stands on it, and
    coarser outward as the triangles of `ground` are; all of it smaller by half than other charts are.

    A ground that is not level is unwrapped, and smaller by four.
    """
    places = object.mesh.positions.numpy()
    size = float(np.ptp(places, axis=0).max())
    if np.ptp(places[:, 1]) > LEVEL * size:
        return unwrap(places, object.mesh.faces.numpy(), object.mesh.name) * GROUND / 2
    about = [each.mesh.positions.numpy()[:, [0, 2]] for each in standing if each.role != "blocker"]
    below = np.concatenate(about) if about else places[:, [0, 2]] / REACH
    middle = (below.min(axis=0) + below.max(axis=0)) / 2
    outline = max(float(np.linalg.norm(below - middle, axis=1).max()), 1e-6 * size)
    way = places[:, [0, 2]] - middle
    far = np.linalg.norm(way, axis=1, keepdims=True)
    near, edge = np.minimum(far, 1.1 * outline), FINE * outline
    # Edges of `ground` grow by COARSENING of the way beyond: so many lie in it, each as long as the first here.
    warped = near + edge / COARSENING * np.log1p(COARSENING * (far - near) / edge)
    shares = np.divide(warped, far, out=np.ones_like(far), where=far > 0)
    faces = object.mesh.faces.numpy()
    plain, found = way[faces], (way * shares)[faces]
    # Large triangles may fold over.
    folded = bool((_signed(plain) * _signed(found) < 0).any())
    return plain * GROUND / 2 if folded else found * GROUND


def _unwrapped(objects: Sequence[Object], why: str) -> _Layout:
    parts = [unwrap(each.mesh.positions.numpy(), each.mesh.faces.numpy(), each.mesh.name) for each in objects]
    return _Layout(parts, [f"charts are made by xatlas, {why}"], packed=False)


def _given(objects: Sequence[Object], number: int, rows: int, columns: int) -> _Layout:
    """A set of texture coordinates as it is."""
    layout = _sets(objects, number)
    for each, pairs in zip(objects, layout.parts, strict=True):
        outside = _outside(pairs)
        if outside:
            raise InputError(
                f"{each.mesh.name}: set {number} of the texture coordinates leaves the square from 0 to 1 with "
                f"{count(outside, 'face')}: give another set, or --uv unwrap"
            )
    shares = [_overlap([pairs], rows, columns) for pairs in layout.parts]
    faulty = [each.mesh.name for each, share in zip(objects, shares, strict=True) if share > OVERLAP]
    if faulty:
        warnings.warn(
            f"{', '.join(faulty)}: set {number} of the texture coordinates puts several faces at one place, on "
            f"{max(shares):.1%} of the texels; the first of them shows there on all: use --uv unwrap",
            AtlasWarning,
            stacklevel=3,
        )
        return layout
    return _beside(objects, layout, number, rows, columns)


def _beside(objects: Sequence[Object], layout: _Layout, number: int, rows: int, columns: int) -> _Layout:
    """The layout as it is, or side by side if objects lie on each other."""
    if len(objects) < 2 or _overlap(layout.parts, rows, columns) <= OVERLAP:
        return layout
    said = f"set {number} of the texture coordinates of {count(len(objects), 'object')}, packed side by side"
    return layout.to_pack(objects, [said, *layout.notes[1:]])


def _decided(objects: Sequence[Object], rows: int, columns: int) -> _Layout:
    """The first set that is fit, else charts made anew; and why."""
    reasons = []
    for number in (1, 0):
        missing = [each.mesh.name for each in objects if number not in each.mesh.uv_sets]
        if missing:
            reasons.append(f"{Path(missing[0]).name} has no set {number}" if number == 0 else "")
            continue
        layout = _sets(objects, number)
        reason = _unfit(layout.parts, rows, columns)
        if not reason:
            return _beside(objects, layout, number, rows, columns)
        reasons.append(f"set {number} {reason}")
    return _unwrapped(objects, "because " + " and ".join(each for each in reasons if each))


def _unfit(found: Sequence[np.ndarray], rows: int, columns: int) -> str:
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


def _sets(objects: Sequence[Object], number: int) -> _Layout:
    """A set of texture coordinates, charts that lie beside the square brought back."""
    found, moved = [], 0
    for each in objects:
        pairs = each.mesh.uv_set(number).numpy().copy()
        pairs[~np.isfinite(pairs).all(axis=(1, 2))] = np.nan
        piece = _pieces(each, pairs)
        low = np.full((int(piece.max(initial=-1)) + 1, 2), np.inf)
        known = ~np.isnan(pairs).any(axis=(1, 2))
        np.minimum.at(low, piece[known], pairs[known].min(axis=1))
        whole = np.floor(np.where(np.isfinite(low), low, 0.0) + 1e-6)
        moved += int((whole != 0).any(axis=1).sum())
        found.append(pairs - whole[piece][:, None])
    notes = [f"set {number} of the texture coordinates"]
    if moved:
        notes.append(f"{count(moved, 'chart')} beside the square brought back by whole numbers")
    mirrored = sum(_mirrored(pairs) for pairs in found)
    if mirrored:
        notes.append(f"{count(mirrored, 'face')} mirrored on the map")
    return _Layout(found, notes, packed=True)


def _faults(objects: Sequence[Object], found: Sequence[Float[np.ndarray, "_ 3 2"]]) -> list[str]:
    """What is to be said of charts as they are, in sentences."""
    areas = [_surface(each) for each in objects]
    missing = [np.isnan(pairs).any(axis=(1, 2)) for pairs in found]
    flat = [_signed(pairs) == 0 for pairs in found]
    lost = sum(int(which.sum()) for which in missing)
    thin = sum(int((which & (area > 0)).sum()) for which, area in zip(flat, areas, strict=True))
    notes = []
    if lost:
        notes.append(f"{count(lost, 'face')} without texture coordinates or area on no chart")
    if thin:
        notes.append(f"{count(thin, 'face')} without area on the map, where what lies beside it shows")
    return notes


def _outside(pairs: Float[np.ndarray, "F 3 2"]) -> int:
    with np.errstate(invalid="ignore"):
        result: int = int(((pairs < -1e-6) | (pairs > 1 + 1e-6)).any(axis=(1, 2)).sum())
    return result


def _overlap(parts: Sequence[Float[np.ndarray, "_ 3 2"]], rows: int, columns: int) -> float:
    """The share of covered texels with a place in several faces."""
    pairs = np.concatenate(list(parts))
    # Coarser it is overlooked, finer nothing more is seen of it.
    rows, columns = (min(max(side, 256), 1024) for side in (rows, columns))
    return overlap(pairs, rows, columns)


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
    known = ~np.isnan(pairs).any(axis=(1, 2))
    area, flat = _surface(object)[known].sum(), np.abs(_signed(pairs[known])).sum()
    return float((area / flat) ** 0.5) if flat > 0 else 1.0


def _surface(object: Object) -> Float[np.ndarray, "F"]:
    """Twice the areas of its faces."""
    corners = object.mesh.positions.numpy()[object.mesh.faces.numpy()]
    result: np.ndarray = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return result


def _pieces(object: Object, pairs: Float[np.ndarray, "F 3 2"]) -> Int[np.ndarray, "F"]:
    """Faces hang together that share an edge both on the surface and on the map."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    place = weld(object.mesh.positions.numpy())[object.mesh.faces.numpy()].reshape(-1, 1)
    key = np.concatenate([place, pairs.reshape(-1, 2)], axis=1)
    # What is missing is alike, so that it is one chart a piece of surface.
    sides = edges(weld(np.nan_to_num(key, nan=-1e30)).reshape(-1, 3))
    first = np.repeat(sides.face[sides.start], sides.count)
    graph = coo_matrix((np.ones(len(first), bool), (first, sides.face)), (len(pairs), len(pairs)))
    result: np.ndarray = connected_components(graph, directed=False)[1].astype(np.int64)
    return result
