"""What texels around the charts of a map show, so that filters read the same surface on both sides of a seam."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from .rasterise import rasterise
from .seams import Seams


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
    beyond: Seams,
    chart_of_face: Int[np.ndarray, "F"],
) -> Gutters:
    """The empty texels that are `width` or less from one of the `texel`s of charts, and what is there.

    Where a chart ends at a seam and the surface goes on in another chart (or elsewhere in the same one), a texel shows
    what a bilinear filter reads of it there; `beyond` has the seams, in texels. Elsewhere, and where nothing is found
    beyond the seam, it shows the nearest texel.
    Law: along a seam of a developable surface a quantity that is linear on the surface is read alike from both sides,
    but for taps that no chart covers.
    """
    from scipy.ndimage import distance_transform_edt

    of_texel = np.full(rows * columns, -1)
    of_texel[texel] = np.arange(len(texel))
    number = of_texel.reshape(rows, columns)
    if not width or not len(texel):
        return Gutters(np.zeros(0, int), np.zeros((0, 4), int), np.zeros((0, 4)))
    transform: Any = distance_transform_edt(number < 0, return_indices=True)
    cell = np.flatnonzero((number < 0) & (transform[0] <= width))
    nearest = number[tuple(axis.ravel()[cell] for axis in transform[1])]
    sources = np.repeat(nearest[:, None], 4, axis=1)
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (len(cell), 1))
    at, place, there = _unfolded(cell, chart[nearest], rows, columns, beyond, chart_of_face)
    taps, shares = _taps(place, number, chart, there, rows, columns)
    # A tap or two may lie beside the chart; half of the weight must not.
    good = shares.sum(1) > 0.5
    sources[at[good]], weights[at[good]] = taps[good], shares[good] / shares[good].sum(1, keepdims=True)
    return Gutters(cell, sources, weights)


def _unfolded(
    cell: np.ndarray, owner: np.ndarray, rows: int, columns: int, beyond: Seams, chart_of_face: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of the texels `cell` lie beyond a seam of the chart that owns them, where on the map the surface that lies
    there is (in texels), and the charts of that."""
    found = rasterise(beyond.uv / [columns, rows], np.arange(len(beyond.uv)), rows, columns, 1)
    inside = found.covered > 0
    texel, which, shares = found.texel[inside], found.face[inside, 0], found.weights[inside, 0]
    at = np.searchsorted(cell, texel).clip(max=max(len(cell) - 1, 0))
    mine = np.zeros(len(texel), bool)
    if len(cell):
        mine = (cell[at] == texel) & (owner[at] == chart_of_face[beyond.face[which]])
    which, shares = which[mine], shares[mine]
    return at[mine], (beyond.place[which] * shares[..., None]).sum(1), chart_of_face[beyond.other[which]]


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
