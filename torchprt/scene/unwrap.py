"""Charts for meshes that have none, by xatlas, and all charts of a scene packed into one map."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

from torchprt.errors import InputError

# The share of the area of a mesh that a chart has at most. Larger charts are fewer, and take five times as long.
LARGEST = 0.02
# Faces up to which they may be as large as they will.
FEW = 4096
# How much smaller charts become from one try to pack them to the next, and how often that is tried.
STEP, TRIES = 0.97, 150
# The share of a map that charts may cover at best, to begin with.
DENSE = 0.75
# The area of the mean chart, in texels, below which they are not made smaller.
LEAST = 0.05
# xatlas leaves out faces with an area below 1e-7 of its unit, which is to be far less than a texel.
FINE = 1024.0


def unwrap(
    positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], name: str = "mesh"
) -> Float[np.ndarray, "F 3 2"]:
    """Charts of a mesh, each as wide as it is on the surface: coordinates of the corners of faces in the unit of the
    mesh, one chart beside the other; NaN for faces without area, which lie on none.

    The same for a mesh that is scaled or moved, up to rounding, and the same bits for the same mesh. A scan of 70 000
    faces takes 7 s of one core, of 280 000 19 s; Ctrl-C waits for that.
    Raises InputError if xatlas makes nothing of it.
    """
    import xatlas

    used = positions[faces]
    low, high = used.min((0, 1)), used.max((0, 1))
    size = float((high - low).max())
    # float32 is all that xatlas takes. A division that is not exact is the same for meshes of all sizes.
    small = ((positions - (low + high) / 2) / size).astype(np.float32)
    area = np.linalg.norm(np.cross(*np.moveaxis(small[faces][:, 1:] - small[faces][:, :1], 1, 0)), axis=1) / 2
    kept = np.flatnonzero(area > 0)
    result = np.full((len(faces), 3, 2), np.nan)
    atlas = xatlas.Atlas()
    try:
        atlas.add_mesh(small, faces[kept].astype(np.uint32))
        options = xatlas.ChartOptions()
        if len(kept) > FEW:
            options.max_chart_area = float(area.sum()) * LARGEST
        packing = xatlas.PackOptions()
        # It is packed again.
        packing.resolution = 512
        atlas.generate(options, packing)
        _, index, pairs = atlas.get_mesh(0)
    except (RuntimeError, ValueError) as fault:
        raise InputError(f"{name} cannot be unwrapped ({fault}): give it texture coordinates") from fault
    if atlas.atlas_count == 0 or len(index) != len(kept):
        raise InputError(f"{name} cannot be unwrapped: give it texture coordinates")
    _, chart = atlas.get_mesh_vertex_assignment(0)
    chart = np.asarray(chart).astype(np.int32)[index[:, 0]].astype(np.int64)
    # It leaves out what it takes for flat.
    kept, index, chart = kept[chart >= 0], index[chart >= 0], chart[chart >= 0]
    texels = pairs[index].astype(np.float64) * [atlas.width, atlas.height]
    # Packing has rounded charts to texels, each by a factor of its own.
    on_map, on_surface = np.bincount(chart, _areas(texels)), np.bincount(chart, area[kept].astype(np.float64))
    scale = np.sqrt(np.divide(on_surface, on_map, out=np.zeros_like(on_map), where=on_map > 0))
    result[kept] = texels * scale[chart][:, None, None] * size
    # Charts of their own places, or two could meet in one after they have been scaled.
    low = np.full((len(scale), 2), np.inf)
    np.minimum.at(low, chart, result[kept].min(axis=1))
    width = np.zeros(len(scale))
    np.maximum.at(width, chart, result[kept][..., 0].max(axis=1) - low[chart, 0])
    start = np.cumsum(1.01 * width) - 1.01 * width
    result[kept] -= (low - np.stack([start, np.zeros_like(start)], -1))[chart][:, None]
    return result


def pack(
    charts: Sequence[Float[np.ndarray, "_ 3 2"]], rows: int, columns: int, gutter: int
) -> list[Float[np.ndarray, "_ 3 2"]]:
    """The charts of all meshes, in one unit of length, on one map: coordinates in [0, 1], v down.

    All are made smaller by one factor, are at least 2 `gutter` texels apart and `gutter` from the border. NaN for faces
    that are there already, and that are a point at this size.
    Raises InputError if they do not fit, as a thousand charts on a map of 8 x 8.
    """
    import xatlas

    known = [np.isfinite(each).all(axis=(1, 2)) for each in charts]
    # Squares as wide as the shorter side, one beside the other along the longer.
    side = min(rows, columns) - 2 * gutter
    squares = max(rows, columns) // min(rows, columns)
    total = sum(float(_areas(each[own]).sum()) for each, own in zip(charts, known, strict=True))
    advice = "give more texels, or a narrower --gutter"
    if side < 1 or total == 0:
        raise InputError(f"a map of {columns} x {rows} texels has no room between gutters of {gutter}: {advice}")
    scale = (DENSE * squares * side**2 / total) ** 0.5
    for _ in range(TRIES):
        atlas = xatlas.Atlas()
        # It knows a mesh by where it is in memory: all are to be there at once.
        held = [_corners(each[own] * (scale * FINE)) for each, own in zip(charts, known, strict=True) if own.any()]
        for arrays in held:
            atlas.add_uv_mesh(*arrays)
        packing = xatlas.PackOptions()
        # It pads both of two neighbours. A single square may grow, which says how far it is from fitting.
        packing.padding, packing.texels_per_unit, packing.resolution = gutter, 1 / FINE, side if squares > 1 else 0
        atlas.generate(xatlas.ChartOptions(), packing)
        if 0 < atlas.atlas_count <= squares and max(atlas.width, atlas.height) <= side:
            return _placed(atlas, known, rows, columns, gutter)
        if total * scale**2 < LEAST * atlas.chart_count:
            # They are as small as texels, and become no smaller on the map.
            break
        widest = max(atlas.width, atlas.height, 1)
        if squares == 1 and widest > 1.01 * side:
            scale *= 0.998 * side / widest
        elif atlas.atlas_count > squares + 1:
            # The last of them may be nearly empty.
            scale *= (squares / (atlas.atlas_count - 1)) ** 0.5
        else:
            scale *= STEP
    raise InputError(f"the charts do not fit on a map of {columns} x {rows} texels with gutters of {gutter}: {advice}")


def _placed(
    atlas: Any, known: Sequence[Bool[np.ndarray, "_"]], rows: int, columns: int, gutter: int
) -> list[Float[np.ndarray, "_ 3 2"]]:
    """Where the corners of all faces have come to."""
    found, number = [], 0
    step = min(rows, columns)
    along = np.array([step, 0] if columns > rows else [0, step])
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
    places, index = np.unique(uv.reshape(-1, 2).astype(np.float32), axis=0, return_inverse=True)
    return places, index.reshape(-1, 3).astype(np.uint32)


def _areas(uv: Float[np.ndarray, "F 3 2"]) -> Float[np.ndarray, "F"]:
    one, other = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    result: np.ndarray = np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / 2
    return result
