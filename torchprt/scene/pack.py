"""Charts of a whole scene packed into one map, by xatlas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt32

from torchprt.errors import InputError

# The share of a map that charts cover at best, where the search begins; and how much smaller they become from one try
# to the next, once they nearly fit.
DENSE, STEP, TRIES = 0.75, 0.985, 40
# The area of the mean chart, in texels, below which charts are not made smaller.
LEAST = 0.05
# On maps up to the one width every place is tried; up to the other every fourth in each direction, or some.
SMALL, THOROUGH = 256, 2048
# xatlas leaves out faces with an area below 1e-7 of its unit, which is to be far less than a texel.
FINE = 1024.0


def pack(
    charts: Sequence[Float[np.ndarray, "_ 3 2"]], rows: int, columns: int, gutter: int
) -> list[Float[np.ndarray, "_ 3 2"]]:
    """The charts of all meshes, in one unit of length, on one map: coordinates in [0, 1], v down.

    All are made smaller by one factor, are at least 2 `gutter` texels apart and `gutter` from the border. Faces at
    one place, and those that share an edge, are one chart. NaN for faces that are there already, and that are a point
    at this size.
    Raises InputError if they do not fit, as a thousand charts on a map of 8 x 8.
    """
    known = [np.isfinite(each).all(axis=(1, 2)) for each in charts]
    side, squares = min(rows, columns) - 2 * gutter, max(rows, columns) // min(rows, columns)
    total = sum(float(_areas(each[own]).sum()) for each, own in zip(charts, known, strict=True))
    advice = "give more texels, or a narrower --gutter"
    if side < 1 or total == 0:
        raise InputError(f"a map of {columns} x {rows} texels has no room between gutters of {gutter}: {advice}")
    meshes = [_corners(each[own]) for each, own in zip(charts, known, strict=True) if own.any()]
    scale = (DENSE * squares * side**2 / total) ** 0.5
    every, number = False, 0
    for attempt in range(TRIES):
        atlas = _packed(meshes, scale, side, squares, gutter, every)
        if attempt == 0 and SMALL < side <= THOROUGH:
            # Few large charts are packed best by the one way, many small ones by the other.
            other = _packed(meshes, scale, side, squares, gutter, not every)
            if _size(other) < _size(atlas):
                atlas, every = other, not every
        number = atlas.chart_count
        if 0 < atlas.atlas_count <= squares and max(atlas.width, atlas.height) <= side:
            return _placed(atlas, known, rows, columns, gutter)
        if total * scale**2 < LEAST * number:
            # They are as small as texels, and become no smaller on the map.
            break
        if squares == 1:
            # Gutters stay as wide as they are, so that charts have to give way for them too.
            scale *= min(STEP, side / max(atlas.width, atlas.height, 1))
        else:
            # The last of them may be nearly empty.
            scale *= min(STEP, (squares / max(atlas.atlas_count - 1, 1)) ** 0.5)
    raise InputError(
        f"the charts do not fit on a map of {columns} x {rows} texels with gutters of {gutter}, there are {number} of "
        f"them: {advice}"
    )


def _size(atlas: Any) -> tuple[int, float]:
    """What is to be small: squares, and the longer side of one, or how much of them is used."""
    return atlas.atlas_count, float(max(atlas.width, atlas.height)) if atlas.atlas_count == 1 else 0.0


def _packed(
    meshes: Sequence[tuple[Float[np.ndarray, "_ 2"], UInt32[np.ndarray, "_ 3"]]],
    scale: float,
    side: int,
    squares: int,
    gutter: int,
    every: bool,
) -> Any:
    import xatlas

    atlas = xatlas.Atlas()
    # It knows a mesh by where it is in memory: all are to be there at once.
    held = [((places * (scale * FINE)).astype(np.float32), faces) for places, faces in meshes]
    for arrays in held:
        atlas.add_uv_mesh(*arrays)
    packing = xatlas.PackOptions()
    # It pads both of two neighbours. A single square may grow, which says how far it is from fitting.
    packing.padding, packing.texels_per_unit, packing.resolution = gutter, 1 / FINE, side if squares > 1 else 0
    packing.bruteForce = side <= SMALL or every
    packing.blockAlign = every
    atlas.generate(xatlas.ChartOptions(), packing)
    return atlas


def _placed(
    atlas: Any, known: Sequence[Bool[np.ndarray, "_"]], rows: int, columns: int, gutter: int
) -> list[Float[np.ndarray, "_ 3 2"]]:
    """Where the corners of all faces have come to, of the squares one beside the other along the longer side."""
    found, number = [], 0
    along = np.array([min(rows, columns), 0] if columns > rows else [0, min(rows, columns)])
    for own in known:
        result = np.full((len(own), 3, 2), np.nan)
        if own.any():
            _, index, pairs = atlas.get_mesh(number)
            square, _ = atlas.get_mesh_vertex_assignment(number)
            square = np.asarray(square).astype(np.int32).astype(np.int64)
            texels = pairs.astype(np.float64) * [atlas.width, atlas.height] + gutter
            texels += square[:, None] * along
            texels[square < 0] = np.nan
            places = texels[index] / [columns, rows]
            places[np.isnan(places).any(axis=(1, 2))] = np.nan
            result[own] = places
            number += 1
        found.append(result)
    return found


def _corners(uv: Float[np.ndarray, "F 3 2"]) -> tuple[Float[np.ndarray, "V 2"], UInt32[np.ndarray, "F 3"]]:
    """Corners at one place as one, which makes faces a chart."""
    places, index = np.unique(uv.reshape(-1, 2), axis=0, return_inverse=True)
    return places, index.reshape(-1, 3).astype(np.uint32)


def _areas(uv: Float[np.ndarray, "F 3 2"]) -> Float[np.ndarray, "F"]:
    one, other = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    result: np.ndarray = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    return result
