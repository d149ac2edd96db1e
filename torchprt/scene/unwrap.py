"""Charts for meshes that have none, by xatlas: cut where surfaces bend, flattened, none of them over itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from torchprt.errors import InputError

from .rasterise import faces_twice
from .weld import weld

# How far a chart may bend before another begins: half as far as by default. Charts are then less stretched.
COST = 1.0
# The share of the area of a mesh that a chart has at most. Larger charts are fewer, and take five times as long.
LARGEST = 0.02
# Faces up to which they may be as large as they will.
FEW = 40_000
# What a mesh is made as wide as for xatlas, which takes areas and edges below 1e-7 for none.
WIDTH = 1024.0
# The size of a part, beside that of all, of which the steps of float32 are too coarse a picture.
SMALL = 1e-4
# How often what it left out, or laid over itself, is tried again.
ROUNDS = 4
# Samples along a side of all charts together, which are looked at for places in several faces.
LOOKED = 1024


class Flat(NamedTuple):
    """Charts of faces: the places of their corners in the unit of the mesh, NaN for those on none; and their number,
    -1 for those."""

    uv: Float[np.ndarray, "F 3 2"]
    chart: Int[np.ndarray, "F"]


def unwrap(
    positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], name: str = "mesh"
) -> Float[np.ndarray, "F 3 2"]:
    """Charts of a mesh, each as wide as it is on the surface: coordinates of the corners of faces in the unit of the
    mesh, one chart beside the other, none over itself; NaN for faces without area, which lie on none.

    The same bits for the same mesh, the same charts for one that is scaled or moved. A scan of 70 000 faces takes 5 s,
    four times as many take four times as long; Ctrl-C waits for it.
    Raises InputError if xatlas makes nothing of it.
    """
    found = Flat(np.full((len(faces), 3, 2), np.nan), np.full(len(faces), -1))
    layer = _layers(positions, faces)
    # Faces upon faces would be joined there, and then be torn apart.
    for number in range(int(layer.max(initial=0)) + 1):
        _fill(found, positions, faces, np.flatnonzero(layer == number), name)
    first = 0
    for part in range(1, ROUNDS):
        over, first = _over_itself(found, first), int(found.chart.max()) + 1
        for number in over:
            some = np.flatnonzero(found.chart == number)
            _fill(found, positions, faces, some, name, 0.25**part)
            left = some[found.chart[some] == number]
            found.uv[left], found.chart[left] = np.nan, -1
    if not (found.chart >= 0).any():
        raise InputError(f"{name} cannot be unwrapped, it has no face but slivers: give it texture coordinates")
    # Each in a place of its own, or two could meet in one after they have been scaled.
    kept = found.chart >= 0
    _, chart = np.unique(found.chart[kept], return_inverse=True)
    low, high = _boxes(found.uv[kept], chart)
    width = high[:, 0] - low[:, 0]
    low[:, 0] -= np.cumsum(1.01 * width) - 1.01 * width
    found.uv[kept] -= low[chart][:, None]
    return found.uv


def _layers(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Int[np.ndarray, "F"]:
    """Of faces with the same three corners which of them each is: 0 for the first."""
    corners = np.sort(weld(positions)[faces], axis=1)
    order = np.lexsort(corners.T)
    again = np.append(False, (corners[order][1:] == corners[order][:-1]).all(axis=1))
    place = np.arange(len(faces))
    result = np.zeros(len(faces), np.int64)
    result[order] = place - np.maximum.accumulate(np.where(again, 0, place))
    return result


def _fill(
    found: Flat,
    positions: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    some: Int[np.ndarray, "f"],
    name: str,
    largest: float | None = None,
) -> None:
    """Charts for `some` of the faces. Parts that are small beside the rest, and what xatlas leaves out, come later,
    alone."""
    for _ in range(ROUNDS):
        large = _large(positions, faces[some])
        now = some[large]
        made = _charts(positions, faces[now], name, largest)
        done = made.chart >= 0
        found.uv[now[done]] = made.uv[done]
        found.chart[now[done]] = made.chart[done] + found.chart.max() + 1
        some = np.setdiff1d(some, now[done])
        if not done.any() or not len(some):
            break


def _large(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Bool[np.ndarray, "F"]:
    """Faces of parts that are not far smaller than all of them together."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, index = np.unique(faces, return_inverse=True)
    places, corner = positions[used], weld(positions[used])[index.reshape(-1, 3)]
    ends = (corner[:, :2].ravel(), corner[:, 1:].ravel())
    graph = coo_matrix((np.ones(len(ends[0]), bool), ends), (len(used), len(used)))
    parts, label = connected_components(graph, directed=False)
    part = label[corner[:, 0]]
    low, high = np.full((parts, 3), np.inf), np.full((parts, 3), -np.inf)
    np.minimum.at(low, part, places[index.reshape(-1, 3)].min(axis=1))
    np.maximum.at(high, part, places[index.reshape(-1, 3)].max(axis=1))
    result: np.ndarray = (high - low).max(axis=1)[part] > SMALL * float((places.max(0) - places.min(0)).max())
    return result if result.any() else np.ones(len(faces), bool)


def _charts(
    positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], name: str, largest: float | None
) -> Flat:
    """What xatlas makes of these faces alone; a chart has at most the share `largest` of their area."""
    import xatlas

    none = Flat(np.full((len(faces), 3, 2), np.nan), np.full(len(faces), -1))
    used, index = np.unique(faces, return_inverse=True)
    index, places = index.reshape(-1, 3), positions[used]
    low, high = places.min(0), places.max(0)
    unit = float((high - low).max()) / WIDTH
    if unit == 0:
        return none
    # float32 is all that it takes; rounded to steps, so that a mesh of another size or place becomes the same numbers.
    small = (np.round((places - (low + high) / 2) / unit * 4096) / 4096).astype(np.float32)
    kept = np.flatnonzero(_areas3(small[index].astype(np.float64)) > 0)
    if not len(kept):
        return none
    # What is small is rounded to few steps, and is to be as wide as it was all the same.
    area = _areas3(places[index]) / unit**2
    atlas = xatlas.Atlas()
    options, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    options.max_cost = COST
    if largest is not None or len(kept) > FEW:
        options.max_chart_area = float(area.sum()) * (LARGEST if largest is None else largest)
    # It is packed again.
    packing.resolution = 512
    try:
        atlas.add_mesh(small, index[kept].astype(np.uint32))
        atlas.generate(options, packing)
        _, corner, pairs = atlas.get_mesh(0)
        _, chart = atlas.get_mesh_vertex_assignment(0)
    except (RuntimeError, ValueError) as fault:
        raise InputError(f"{name} cannot be unwrapped ({fault}): give it texture coordinates") from fault
    if len(corner) != len(kept):
        raise InputError(f"{name} cannot be unwrapped, faces are lost: give it texture coordinates")
    number = np.asarray(chart).astype(np.int32)[corner[:, 0]].astype(np.int64)
    if not atlas.atlas_count:
        number[:] = -1
    placed = number >= 0
    kept, number = kept[placed], number[placed]
    texels = pairs[corner[placed]].astype(np.float64) * [atlas.width, atlas.height]
    # Packing has rounded charts to texels, each by a factor of its own.
    size = int(number.max(initial=-1)) + 1
    flat, own = np.bincount(number, _areas(texels), size), np.bincount(number, area[kept], size)
    scale = np.sqrt(np.divide(own, flat, out=np.zeros(size), where=flat > 0))
    none.uv[kept], none.chart[kept] = texels * scale[number][:, None, None] * unit, number
    return none


def _over_itself(found: Flat, first: int) -> Int[np.ndarray, "n"]:
    """The charts from number `first` on that have two faces at one place."""
    kept = np.flatnonzero(found.chart >= first)
    _, chart, faces = np.unique(found.chart[kept], return_inverse=True, return_counts=True)
    # One or two faces do not lie over each other.
    kept, chart = kept[faces[chart] > 2], chart[faces[chart] > 2]
    if not len(kept):
        return np.zeros(0, np.int64)
    numbers, chart = np.unique(found.chart[kept], return_inverse=True)
    # Each chart in a tile, which it fills.
    low, high = _boxes(found.uv[kept], chart)
    across = int(np.ceil(len(numbers) ** 0.5))
    tile = np.stack([np.arange(len(numbers)) % across, np.arange(len(numbers)) // across], -1)
    share = (found.uv[kept] - low[chart][:, None]) / np.maximum(high - low, 1e-300)[chart][:, None]
    uv = (0.01 + 0.98 * share + tile[chart][:, None]) / across
    side = max(LOOKED, 8 * across)
    result: np.ndarray = np.unique(numbers[chart[faces_twice(uv, side, side)]])
    return result


def _boxes(
    uv: Float[np.ndarray, "F 3 2"], chart: Int[np.ndarray, "F"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """The lowest and highest coordinates of charts."""
    size = int(chart.max(initial=-1)) + 1
    low, high = np.full((size, 2), np.inf), np.full((size, 2), -np.inf)
    np.minimum.at(low, chart, uv.min(axis=1))
    np.maximum.at(high, chart, uv.max(axis=1))
    return low, high


def _areas(uv: Float[np.ndarray, "F 3 2"]) -> Float[np.ndarray, "F"]:
    one, other = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    result: np.ndarray = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    return result


def _areas3(corners: Float[np.ndarray, "F 3 3"]) -> Float[np.ndarray, "F"]:
    result: np.ndarray = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return result / 2
