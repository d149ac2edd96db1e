"""Which texels of a map faces cover, and where in them they are sampled: conservative rasterisation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .seams import Seams

# Samples that are looked at together.
BLOCK = 1 << 20
# In texels: what is covered by less is not covered, and what overlaps by less does not overlap.
SLACK = 1e-4
# How far a point on the border of a chart is moved toward the middle of its face, as a share of the way.
INWARD = 1e-3


@dataclass(frozen=True)
class Raster:
    """The texels that faces cover, each with S = k * k samples.

    - `texel [V]`: their numbers, row * columns + column, ascending; each is of one chart.
    - `face [V, S]`, `weights [V, S, 3]`: the face of each sample, and the weights of its corners. Samples that would
      lie beside the chart repeat others of the same texel.
    - `own [V, S]`: which samples lie in the chart, at their own places of a regular grid, row after row; none where the
      chart only touches the texel: all samples are then the point of it that is nearest to the middle.
    - `twice`: how many texels have a sample in several faces.
    - `lost [F]`: faces that have no texel of their own, because others fill theirs.
    """

    texel: Int[np.ndarray, "V"]
    face: Int[np.ndarray, "V S"]
    weights: Float[np.ndarray, "V S 3"]
    own: Bool[np.ndarray, "V S"]
    twice: int
    lost: Bool[np.ndarray, "F"]

    @property
    def covered(self) -> Int[np.ndarray, "V"]:
        """How many samples of each lie in its chart."""
        count: np.ndarray = self.own.sum(axis=1)
        return count


def with_seams(
    raster: Raster, beyond: Seams, chart: Int[np.ndarray, "F"], rows: int, columns: int, across: int
) -> Raster:
    """The same whose samples beside a chart lie on the surface beyond its seams, where it goes on there: so that what a
    texel holds is of its middle also on the border of a chart. `beyond`: in texels, as far as 1."""
    if not len(beyond.uv) or bool(raster.own.all()):
        return raster
    size = np.array([columns, rows])
    found = rasterise(beyond.uv / size, np.arange(len(beyond.uv)), rows * across, columns * across, 1)
    inside = found.covered > 0
    sample, which, shares = found.texel[inside], found.face[inside, 0], found.weights[inside, 0]
    row, column = sample // (columns * across), sample % (columns * across)
    texel = row // across * columns + column // across
    slot = row % across * across + column % across
    at = np.searchsorted(raster.texel, texel).clip(max=len(raster.texel) - 1)
    mine = (raster.texel[at] == texel) & ~raster.own[at, slot]
    mine &= chart[raster.face[at, 0]] == chart[beyond.face[which]]
    at, slot, which, shares = at[mine], slot[mine], which[mine], shares[mine]
    face, weights, own = raster.face.copy(), raster.weights.copy(), raster.own.copy()
    face[at, slot] = beyond.other[which]
    there = (beyond.weights[which] * shares[..., None]).sum(1).clip(min=0)
    weights[at, slot] = there / there.sum(1, keepdims=True)
    own[at, slot] = True
    changed = np.unique(at)
    chosen = instead(own[changed])
    face[changed] = np.take_along_axis(face[changed], chosen, axis=1)
    weights[changed] = np.take_along_axis(weights[changed], chosen[..., None], axis=1)
    return Raster(raster.texel, face, weights, own, raster.twice, raster.lost)


def rasterise(
    uv: Float[np.ndarray, "F 3 2"], chart: Int[np.ndarray, "F"], rows: int, columns: int, across: int = 2
) -> Raster:
    """The texels of a `rows` x `columns` map that faces with texture coordinates `uv` in [0, 1] cover, v down.

    Every texel that a face touches is covered. `across`: samples along each side of a texel, on a regular grid.
    A texel is of the `chart` that most of its samples are in, or, where there is none, of that which is nearest to its
    middle. Faces whose coordinates are missing (NaN) or outside of the square cover what lies inside.
    Laws: samples on the edge of two faces are of the first; a map of twice the size and half the `across` has the same
    samples. Time and memory: of the samples of the map, 10 bytes each, and of those that are covered.
    """
    known = np.isfinite(uv).all(axis=(1, 2))
    corners = np.where(known[:, None, None], uv, 0.0) * [columns, rows]
    cover, several = _covers(corners * across, known, rows * across, columns * across, across)
    twice = int(several.reshape(rows, across, columns, across).any(axis=(1, 3)).sum())
    texel, face, slot, own = _texels(cover, chart, across)
    del cover
    weights = _weights(corners, texel, face, slot, columns, across)
    more, nearest, near_weights = _touched(corners, known, rows, columns, texel)
    repeated = np.repeat(nearest[:, None].astype(np.int32), across**2, axis=1)
    texel = np.concatenate([texel, more])
    order = np.argsort(texel, kind="stable")
    face = np.concatenate([face, repeated])[order]
    weights = np.concatenate([weights, np.repeat(near_weights[:, None].astype(np.float32), across**2, axis=1)])[order]
    lost = known.copy()
    lost[face.ravel()] = False
    own = np.concatenate([own, np.zeros((len(more), across**2), bool)])[order]
    return Raster(texel[order], face, weights, own, twice, lost)


def faces_twice(uv: Float[np.ndarray, "F 3 2"], rows: int, columns: int) -> Int[np.ndarray, "n"]:
    """Of each of the middles of texels that lie in several faces, and not on their edges, the first of these."""
    known = np.isfinite(uv).all(axis=(1, 2))
    cover, several = _covers(np.where(known[:, None, None], uv, 0.0) * [columns, rows], known, rows, columns, 1)
    result: np.ndarray = cover[several]
    return result


def overlap(uv: Float[np.ndarray, "F 3 2"], rows: int, columns: int) -> float:
    """The share of the texels with a sample in a face, of four each, that have one in several faces."""
    known = np.isfinite(uv).all(axis=(1, 2))
    corners = np.where(known[:, None, None], uv, 0.0) * [2 * columns, 2 * rows]
    cover, several = _covers(corners, known, 2 * rows, 2 * columns, 2)
    twice, covered = (int(each.reshape(rows, 2, columns, 2).any(axis=(1, 3)).sum()) for each in (several, cover >= 0))
    return twice / max(covered, 1)


def _covers(
    corners: Float[np.ndarray, "F 3 2"], known: Bool[np.ndarray, "F"], rows: int, columns: int, across: int
) -> tuple[Int[np.ndarray, "rows columns"], Bool[np.ndarray, "rows columns"]]:
    """The first face that every sample lies in, -1 for none, and which are in several, and not on their edges."""
    none = np.iinfo(np.int32).max
    cover = np.full(rows * columns, none, np.int32)
    several = np.zeros(rows * columns, bool)
    inside = np.zeros(rows * columns, bool)
    last_turn = np.zeros(rows * columns, np.int32)
    for face, row in _rows_of(corners[..., 1] - 0.5, known, rows, closed=True):
        low, high = _span(corners[face], row + 0.5)
        first = np.clip(np.ceil(low - 0.5), 0, columns).astype(np.int64)
        last = np.clip(np.floor(high - 0.5), -1, columns - 1).astype(np.int64)
        for some, column in _expanded(first, last):
            cell = row[some] * columns + column
            x, y = column + 0.5, row[some] + 0.5
            heights = corners[face[some], :, 1]
            margin = SLACK * across
            strictly = (x > low[some] + margin) & (x < high[some] - margin)
            strictly &= (y > heights.min(1) + margin) & (y < heights.max(1) - margin)
            deep, turn = cell[strictly], np.arange(int(strictly.sum()), dtype=np.int32)
            several[deep[inside[deep]]] = True
            # Twice in one go: the last write wins.
            last_turn[deep] = turn
            several[deep[last_turn[deep] != turn]] = True
            inside[deep] = True
            # Faces ascend, and what is written last is to be the first.
            first_face = np.minimum(cover[cell], face[some])
            cover[cell[::-1]] = first_face[::-1]
    cover[cover == none] = -1
    return cover.reshape(rows, columns), several.reshape(rows, columns)


def _rows_of(
    heights: Float[np.ndarray, "F 3"], known: Bool[np.ndarray, "F"], rows: int, closed: bool
) -> Iterator[tuple[Int[np.ndarray, "s"], Int[np.ndarray, "s"]]]:
    """Every face with every row that it meets, a block at a time: rows whose number lies within its heights, or, unless
    `closed`, whose unit of height it has a part in."""
    low, high = heights.min(1), heights.max(1)
    if closed:
        first, last = np.ceil(low), np.floor(high)
    else:
        first, last = np.floor(low + SLACK), np.ceil(high - SLACK) - 1
        # Less than the slack: the row of its middle.
        flat = last < first
        first = np.where(flat, np.floor((low + high) / 2), first)
        last = np.where(flat, first, last)
    first = np.clip(first, 0, rows).astype(np.int64)
    last = np.where(known, np.clip(last, -1, rows - 1), -1).astype(np.int64)
    yield from _expanded(first, last)


def _expanded(
    first: Int[np.ndarray, "n"], last: Int[np.ndarray, "n"]
) -> Iterator[tuple[Int[np.ndarray, "s"], Int[np.ndarray, "s"]]]:
    """Numbers `first` to `last` of each of n, and of which they are, in blocks."""
    count = np.maximum(last - first + 1, 0)
    ends = np.cumsum(count)
    start = 0
    while start < len(count):
        before = ends[start - 1] if start else 0
        # At least one, however many it has.
        stop = max(int(np.searchsorted(ends, before + BLOCK, side="right")), start + 1)
        which = np.repeat(np.arange(start, stop), count[start:stop])
        begins = np.repeat(ends[start:stop] - count[start:stop], count[start:stop])
        yield which, first[which] + np.arange(before, before + len(which)) - begins
        start = stop


def _span(corners: Float[np.ndarray, "s 3 2"], height: Float[np.ndarray, "s"]) -> tuple[np.ndarray, np.ndarray]:
    """From where to where triangles are cut at a height; an edge is cut at the same place in both of its faces."""
    low, high = np.full(len(corners), np.inf), np.full(len(corners), -np.inf)
    for one, other in ((0, 1), (1, 2), (2, 0)):
        a, b = corners[:, one], corners[:, other]
        swap = (a[:, 1] > b[:, 1]) | ((a[:, 1] == b[:, 1]) & (a[:, 0] > b[:, 0]))
        a, b = np.where(swap[:, None], b, a), np.where(swap[:, None], a, b)
        met = (a[:, 1] <= height) & (height <= b[:, 1])
        rise = b[:, 1] - a[:, 1]
        share = np.divide(height - a[:, 1], rise, out=np.zeros_like(rise), where=rise > 0)
        x = a[:, 0] + share * (b[:, 0] - a[:, 0])
        low = np.where(met, np.minimum(low, x), low)
        # A horizontal edge is met from end to end.
        high = np.where(met, np.maximum(high, np.where(rise > 0, x, b[:, 0])), high)
    return low, high


def _texels(
    cover: Int[np.ndarray, "rows columns"], chart: Int[np.ndarray, "F"], across: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Texels with a sample in a face, ascending: of each the faces and places (numbers within the texel) of S samples,
    and which of them are its own. A strip of rows at a time."""
    rows, columns = cover.shape[0] // across, cover.shape[1] // across
    strip = max(1, BLOCK // (columns * across**2))
    parts = []
    for first in range(0, rows, strip):
        some = cover[first * across : (first + strip) * across].reshape(-1, across, columns, across)
        samples = some.transpose(0, 2, 1, 3).reshape(-1, across**2)
        texel = np.flatnonzero((samples >= 0).any(axis=1))
        samples = samples[texel]
        number = np.where(samples >= 0, chart[samples], -1)
        own = number == _winner(number)[:, None]
        slot = instead(own)
        parts.append((texel + first * columns, np.take_along_axis(samples, slot, axis=1), slot.astype(np.int8), own))
    none = np.zeros(0, np.int64), np.zeros((0, across**2), np.int32), np.zeros((0, across**2), np.int8)
    joined = zip(*[(*none, np.zeros((0, across**2), bool)), *parts], strict=True)
    texel, face, slot, own = (np.concatenate(part) for part in joined)
    return texel, face, slot, own


def _winner(number: Int[np.ndarray, "V S"]) -> Int[np.ndarray, "V"]:
    """The chart that most samples of each texel are of, of several the first; -1 is none."""
    votes = np.stack([(number == each[:, None]).sum(axis=1, dtype=np.int16) for each in number.T], axis=1)
    votes[number < 0] = 0
    most = votes == votes.max(axis=1, keepdims=True, initial=0)
    result: np.ndarray = np.where(most, number, np.iinfo(number.dtype).max).min(axis=1, initial=2**31 - 1)
    return result


def instead(own: Bool[np.ndarray, "V S"]) -> Int[np.ndarray, "V S"]:
    """Which sample of a texel stands for each: itself if it is its own, else one of those that are, in turn."""
    ranked = np.argsort(~own, axis=1, kind="stable")
    place = np.arange(own.shape[1])
    others = np.take_along_axis(ranked, place[None] % np.maximum(own.sum(axis=1), 1)[:, None], axis=1)
    return np.where(own, place, others)


def _weights(
    corners: Float[np.ndarray, "F 3 2"],
    texel: Int[np.ndarray, "V"],
    face: Int[np.ndarray, "V S"],
    slot: Int[np.ndarray, "V S"],
    columns: int,
    across: int,
) -> Float[np.ndarray, "V S 3"]:
    """Weights of the corners of faces at the samples in them."""
    result = np.empty((*face.shape, 3), np.float32)
    for some in np.array_split(np.arange(len(face)), face.size // BLOCK + 1):
        x = (texel[some] % columns)[:, None] + (slot[some] % across + 0.5) / across
        y = (texel[some] // columns)[:, None] + (slot[some] // across + 0.5) / across
        p = np.stack([x, y], axis=-1)
        a, b, c = np.moveaxis(corners[face[some]], -2, 0)
        parts = np.stack([_cross(b - p, c - p), _cross(c - p, a - p), _cross(a - p, b - p)], axis=-1)
        # Rounding leaves a sample on an edge a little outside.
        parts = np.maximum(parts * np.sign(parts.sum(-1, keepdims=True)), 0)
        total = parts.sum(-1, keepdims=True)
        result[some] = np.divide(parts, total, out=np.full_like(parts, 1 / 3), where=total > 0)
    return result


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    result: np.ndarray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result


def _touched(
    corners: Float[np.ndarray, "F 3 2"], known: Bool[np.ndarray, "F"], rows: int, columns: int, taken: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Texels that faces touch and that have no sample, ascending; the nearest face to the middle of each, and the
    weights of its corners at its nearest point."""
    free = np.ones(rows * columns, bool)
    free[taken] = False
    pairs: list[tuple[np.ndarray, np.ndarray]] = []
    for face, row in _rows_of(corners[..., 1], known, rows, closed=False):
        low, high = _extent(corners[face], row)
        first, last = np.floor(low + SLACK), np.ceil(high - SLACK) - 1
        thin = last < first
        first = np.where(thin, np.floor((low + high) / 2), first)
        last = np.where(thin, first, last)
        first = np.clip(first, 0, columns).astype(np.int64)
        for some, column in _expanded(first, np.clip(last, -1, columns - 1).astype(np.int64)):
            cell = row[some] * columns + column
            open = free[cell]
            pairs.append((cell[open], face[some][open]))
    cell, face = (
        (np.concatenate([np.zeros(0, np.int64), *part]) for part in zip(*pairs, strict=True))
        if pairs
        else (
            np.zeros(0, np.int64),
            np.zeros(0, np.int64),
        )
    )
    middle = np.stack([cell % columns + 0.5, cell // columns + 0.5], axis=-1)
    weights, distance = _nearest(corners[face], middle)
    order = np.lexsort((face, distance, cell))
    chosen = order[np.unique(cell[order], return_index=True)[1]]
    return cell[chosen], face[chosen], weights[chosen] * (1 - INWARD) + INWARD / 3


def _extent(corners: Float[np.ndarray, "s 3 2"], row: Int[np.ndarray, "s"]) -> tuple[np.ndarray, np.ndarray]:
    """From where to where triangles reach within a row of texels."""
    y = corners[..., 1]
    within = (y >= row[:, None]) & (y <= row[:, None] + 1)
    low = np.where(within, corners[..., 0], np.inf).min(1)
    high = np.where(within, corners[..., 0], -np.inf).max(1)
    for border in (row, row + 1):
        left, right = _span(corners, border.astype(float))
        low, high = np.minimum(low, left), np.maximum(high, right)
    return low, high


def _nearest(
    corners: Float[np.ndarray, "s 3 2"], point: Float[np.ndarray, "s 2"]
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, "s"]]:
    """Weights of the point of each triangle that is nearest to a point, and how far it is."""
    best = np.full(len(corners), np.inf)
    weights = np.zeros((len(corners), 3))
    for one, other in ((0, 1), (1, 2), (2, 0)):
        a, b = corners[:, one], corners[:, other]
        along = b - a
        length = (along * along).sum(-1)
        share = np.divide(((point - a) * along).sum(-1), length, out=np.zeros_like(length), where=length > 0)
        share = np.clip(share, 0, 1)
        away = np.linalg.norm(a + share[:, None] * along - point, axis=-1)
        nearer = away < best
        best = np.where(nearer, away, best)
        found = np.zeros_like(weights)
        found[:, one], found[:, other] = 1 - share, share
        weights = np.where(nearer[:, None], found, weights)
    a, b, c = np.moveaxis(corners, -2, 0)
    parts = np.stack([_cross(b - point, c - point), _cross(c - point, a - point), _cross(a - point, b - point)], -1)
    total = parts.sum(-1)
    inside = (total != 0) & ((parts * np.sign(total)[:, None]) >= 0).all(-1)
    share = np.divide(parts, total[:, None], out=np.zeros_like(parts), where=total[:, None] != 0)
    return np.where(inside[:, None], share, weights), np.where(inside, 0.0, best)
