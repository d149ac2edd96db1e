"""What texels around the charts of a map show, so that filters read the same surface on both sides of a seam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt

from .normals import face_normals
from .rasterise import rasterise
from .weld import edges, weld

# The cosine between the normals of two faces below which their edge is one, and no seam of one surface.
SMOOTH = 0.9


@dataclass(frozen=True)
class Gutters:
    """`texel [E]`, ascending: what is there is the sum of `weights [E, 4]` times the receivers `sources [E, 4]`."""

    texel: Int[np.ndarray, "E"]
    sources: Int[np.ndarray, "E 4"]
    weights: Float[np.ndarray, "E 4"]


def gutters(
    texel: Int[np.ndarray, "V"],
    chart: Int[np.ndarray, "V"],
    rows: int,
    columns: int,
    width: int,
    positions: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "F 3 3"],
    uv: Float[np.ndarray, "F 3 2"],
    chart_of_face: Int[np.ndarray, "F"],
) -> Gutters:
    """The empty texels that are `width` or less from one of the `texel`s of charts, and what is there.

    Where a chart ends at a seam and the surface goes on smoothly in another chart (or elsewhere in the same one), the
    surface is unfolded about the edge, and a texel beyond it shows what a bilinear filter reads of it there. Elsewhere,
    and where nothing is found beyond the seam, it shows the nearest texel.
    `normals`: of the corners of faces, which say where a surface is smooth.
    Law: along a seam of a developable surface a quantity that is linear on the surface is read alike from both sides,
    but for taps that no chart covers.
    """
    number = np.full(rows * columns, -1)
    number[texel] = np.arange(len(texel))
    number = number.reshape(rows, columns)
    if not width or not len(texel):
        return Gutters(np.zeros(0, int), np.zeros((0, 4), int), np.zeros((0, 4)))
    away, near = distance_transform_edt(number < 0, return_indices=True)
    cell = np.flatnonzero((number < 0) & (away <= width))
    nearest = number[near[0].ravel()[cell], near[1].ravel()[cell]]
    sources = np.repeat(nearest[:, None], 4, axis=1)
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(cell), 1))
    beyond, place, there = _beyond_seams(
        rows, columns, width, positions, faces, normals, uv, chart_of_face, cell, chart[nearest]
    )
    taps, shares = _taps(place, number, chart, there, rows, columns)
    # A tap or two may lie beside the chart; half of the weight must not.
    good = shares.sum(1) > 0.5
    at = np.searchsorted(cell, beyond[good])
    sources[at], weights[at] = taps[good], shares[good] / shares[good].sum(1, keepdims=True)
    return Gutters(cell, sources, weights)


def _beyond_seams(
    rows: int,
    columns: int,
    width: int,
    positions: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray,
    uv: np.ndarray,
    chart_of_face: np.ndarray,
    cell: np.ndarray,
    owner: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Texels of `cell` beyond a seam of the chart that owns them: their numbers, where on the map the surface that lies
    there is (in texels), and the charts that they show."""
    face, corner, other, other_corner = _seams(positions, faces, normals, uv)
    size = np.array([columns, rows], float)
    outward = _outward(positions, faces, uv * size, face, corner)
    inward = -_outward(positions, faces, uv * size, other, other_corner)
    a, b = uv[face, corner] * size, uv[face, (corner + 1) % 3] * size
    # The other face runs along the edge the other way.
    c, d = uv[other, (other_corner + 1) % 3] * size, uv[other, other_corner] * size
    length = np.linalg.norm(b - a, axis=1)
    keep = (length > 1e-9) & np.isfinite(outward).all(1) & np.isfinite(inward).all(1)
    face, other, a, b, c, d, outward, inward = (
        each[keep] for each in (face, other, a, b, c, d, outward, inward)
    )
    # As far as the gutter is wide, measured at right angles to the edge.
    edge = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
    sideways = outward - (outward * edge).sum(1, keepdims=True) * edge
    reach = (width + 1) / np.maximum(np.linalg.norm(sideways, axis=1, keepdims=True), 1e-9)
    quads = np.stack([a, b, b + reach * outward, a + reach * outward], axis=1)
    ends = np.stack([c, d, d + reach * inward, c + reach * inward], axis=1)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    places = np.concatenate([ends[:, [0, 1, 2]], ends[:, [0, 2, 3]]])
    here, there = np.tile(chart_of_face[face], 2), np.tile(chart_of_face[other], 2)
    found = rasterise(triangles / size, np.arange(len(triangles)), rows, columns, 1)
    inside = found.covered > 0
    texel, which, shares = found.texel[inside], found.face[inside, 0], found.weights[inside, 0]
    # Only what is nearest to the chart whose seam it is.
    at = np.clip(np.searchsorted(cell, texel), 0, max(len(cell) - 1, 0))
    mine = (cell[at] == texel) & (owner[at] == here[which]) if len(cell) else np.zeros(len(texel), bool)
    texel, which, shares = texel[mine], which[mine], shares[mine]
    return texel, (places[which] * shares[..., None]).sum(1), there[which]


def _seams(
    positions: np.ndarray, faces: np.ndarray, normals: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Every edge whose two faces, wound alike and with normals that agree, have it at different places of the map: a
    face and the corner that its edge starts at, the other face and corner; each seam twice, once from either side."""
    joined = weld(positions)[faces]
    sides = edges(joined)
    pairs = sides.start[sides.count == 2]
    one, other = sides.face[pairs], sides.face[pairs + 1]
    one_corner, other_corner = sides.side[pairs], sides.side[pairs + 1]
    # Ends in the order of the first face; the other runs against it.
    agrees = joined[one, one_corner] == joined[other, (other_corner + 1) % 3]
    agrees &= joined[other, other_corner] == joined[one, (one_corner + 1) % 3]
    smooth = np.ones(len(one), bool)
    for at in (0, 1):
        mine, its = normals[one, (one_corner + at) % 3], normals[other, (other_corner + 1 - at) % 3]
        smooth &= (mine * its).sum(1) > SMOOTH
    first = uv[one, one_corner], uv[one, (one_corner + 1) % 3]
    second = uv[other, (other_corner + 1) % 3], uv[other, other_corner]
    apart = np.zeros(len(one))
    for mine, its in zip(first, second, strict=True):
        apart = np.maximum(apart, np.abs(mine - its).max(1))
    seam = agrees & smooth & (apart > 1e-9)
    one, one_corner, other, other_corner = (each[seam] for each in (one, one_corner, other, other_corner))
    return (
        np.concatenate([one, other]),
        np.concatenate([one_corner, other_corner]),
        np.concatenate([other, one]),
        np.concatenate([other_corner, one_corner]),
    )


def _outward(
    positions: np.ndarray, faces: np.ndarray, uv: np.ndarray, face: np.ndarray, corner: np.ndarray
) -> Float[np.ndarray, "s 2"]:
    """How the map moves by a unit of length out of a face, at right angles to an edge; not finite for faces without
    area."""
    order = (corner[:, None] + np.arange(3)) % 3
    p = np.take_along_axis(positions[faces[face]], order[..., None], axis=1)
    t = np.take_along_axis(uv[face], order[..., None], axis=1)
    edge, side = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    length = np.linalg.norm(edge, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (side * edge).sum(1, keepdims=True) / length**2
        height = np.linalg.norm(side - share * edge, axis=1, keepdims=True)
        # The third corner is at `share` of the edge and `height` inside.
        result: np.ndarray = -((t[:, 2] - t[:, 0]) - share * (t[:, 1] - t[:, 0])) / height
    return result


def _taps(
    place: np.ndarray, number: np.ndarray, chart: np.ndarray, there: np.ndarray, rows: int, columns: int
) -> tuple[Int[np.ndarray, "E 4"], Float[np.ndarray, "E 4"]]:
    """The receivers that a bilinear filter reads at places of the map (in texels), and their weights; 0 for those of
    other charts or of none."""
    low = np.floor(place - 0.5)
    share = place - 0.5 - low
    taps, weights = [], []
    for right, lower in ((0, 0), (1, 0), (0, 1), (1, 1)):
        x, y = (low[:, 0] + right).astype(int), (low[:, 1] + lower).astype(int)
        inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        found = np.where(inside, number[np.clip(y, 0, rows - 1), np.clip(x, 0, columns - 1)], -1)
        weight = np.where(right, share[:, 0], 1 - share[:, 0]) * np.where(lower, share[:, 1], 1 - share[:, 1])
        own = (found >= 0) & (chart[found] == there)
        taps.append(np.where(own, found, 0))
        weights.append(np.where(own, weight, 0.0))
    return np.stack(taps, 1), np.stack(weights, 1)
