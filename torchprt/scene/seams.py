"""How a surface goes on beyond the border of a chart, where the border is only a seam of the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from .weld import edges, weld

# The cosine between the normals of two faces at their edge below which it is one, and no seam of one surface.
SMOOTH = 0.9
# Depths of strips, each twice the one before.
LEVELS = 4


@dataclass(frozen=True)
class Seams:
    """Triangles on a map beyond the seams of its charts, and the surface that lies there, unfolded about the seam.

    Of each of T triangles: `uv [T, 3, 2]`, where its corners are beside the chart; `face [T]`, the face on this side;
    `other [T]`, the face beyond; `weights [T, 3, 3]`, the weights of the corners of that at each corner; `place
    [T, 3, 2]`, where that puts it on the map. All are linear over the triangle; lengths on the surface are kept.
    """

    uv: Float[np.ndarray, "T 3 2"]
    face: Int[np.ndarray, "T"]
    other: Int[np.ndarray, "T"]
    weights: Float[np.ndarray, "T 3 3"]
    place: Float[np.ndarray, "T 3 2"]

    def take(self, chosen: Bool[np.ndarray, "T"]) -> Seams:
        """Those that are chosen."""
        return Seams(*(part[chosen] for part in (self.uv, self.face, self.other, self.weights, self.place)))


def seams(
    positions: Float[np.ndarray, "P 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "F 3 3"],
    uv: Float[np.ndarray, "F 3 2"],
    width: float,
) -> Seams:
    """The seams of a surface whose faces are at `uv` of a map, as far as `width` beyond, in the unit of `uv`.

    A seam is an edge of two faces, wound alike and with `normals` (of the corners of faces) that agree, that are at
    different places of the map. Each is there from either side as several strips along the edge, the shallow ones of
    all seams before the deep ones, so that the first that covers a place is that of the nearest seam, or nearly so; and
    of each depth once more as much longer, which fills the gaps where a border turns.
    """
    face, corner, other, other_corner = _pairs(positions, faces, normals, uv)
    outward, _, _ = _outward(positions, faces, uv, face, corner)
    inward, other_share, other_height = _outward(positions, faces, uv, other, other_corner)
    inward = -inward
    a, b = uv[face, corner], uv[face, (corner + 1) % 3]
    # The other face runs along the edge the other way.
    start, end = (other_corner + 1) % 3, other_corner
    c, d = uv[other, start], uv[other, end]
    along = b - a
    length = np.linalg.norm(along, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        edge = along / length
        # As far as `width`, at right angles to the edge on the map.
        sideways = outward - (outward * edge).sum(1, keepdims=True) * edge
        reach = width / np.linalg.norm(sideways, axis=1)
        row = np.arange(len(face))
        step = np.zeros((len(face), 3))
        step[row, (other_corner + 2) % 3] = reach / other_height
        # Its share is measured from where it starts itself, which is the end here.
        step[row, end] -= (1 - other_share) * reach / other_height
        step[row, start] -= other_share * reach / other_height
    keep = np.isfinite(reach) & np.isfinite(step).all(1) & np.isfinite(inward).all(1)
    first, last = np.zeros((len(face), 3)), np.zeros((len(face), 3))
    first[row, start], last[row, end] = 1, 1
    far = np.where(keep, reach, 0)[:, None]
    with np.errstate(divide="ignore"):
        more = np.where(keep, width / length[:, 0], 0)[:, None]
    shares = [0.5**level for level in reversed(range(LEVELS))]

    def strips(one: np.ndarray, two: np.ndarray, move: np.ndarray) -> np.ndarray:
        found = []
        for share in shares:
            before, behind = one - share * more * (two - one), two + share * more * (two - one)
            for start, end in ((one, two), (before, behind)):
                quads = np.stack([start, end, end + share * move, start + share * move], axis=1)[keep]
                found += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        return np.concatenate(found)

    return Seams(
        strips(a, b, far * outward),
        np.tile(face[keep], 4 * LEVELS),
        np.tile(other[keep], 4 * LEVELS),
        strips(first, last, step),
        strips(c, d, far * inward),
    )


def _pairs(
    positions: np.ndarray, faces: np.ndarray, normals: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Every seam from either side: a face and the corner that its edge starts at, the other face and corner."""
    joined = weld(positions)[faces]
    sides = edges(joined)
    pairs = sides.start[sides.count == 2]
    one, other = sides.face[pairs], sides.face[pairs + 1]
    one_corner, other_corner = sides.side[pairs], sides.side[pairs + 1]
    agrees = joined[one, one_corner] == joined[other, (other_corner + 1) % 3]
    agrees &= joined[other, other_corner] == joined[one, (one_corner + 1) % 3]
    apart = np.zeros(len(one))
    for at in (0, 1):
        mine, its = (one, (one_corner + at) % 3), (other, (other_corner + 1 - at) % 3)
        agrees &= (normals[mine] * normals[its]).sum(1) > SMOOTH
        apart = np.maximum(apart, np.abs(uv[mine] - uv[its]).max(1))
    # Comparisons with what is missing are false.
    seam = agrees & (apart > 1e-9 * np.nanmax(np.abs(uv), initial=1.0))
    one, one_corner, other, other_corner = (each[seam] for each in (one, one_corner, other, other_corner))
    return (
        np.concatenate([one, other]),
        np.concatenate([one_corner, other_corner]),
        np.concatenate([other, one]),
        np.concatenate([other_corner, one_corner]),
    )


def _outward(
    positions: np.ndarray, faces: np.ndarray, uv: np.ndarray, face: np.ndarray, corner: np.ndarray
) -> tuple[Float[np.ndarray, "s 2"], Float[np.ndarray, "s"], Float[np.ndarray, "s"]]:
    """How the map moves by a unit of length out of a face, at right angles to an edge; how far along the edge its third
    corner is (as a share of it), and how far inside. Not finite for faces without area."""
    order = (corner[:, None] + np.arange(3)) % 3
    p = np.take_along_axis(positions[faces[face]], order[..., None], axis=1)
    t = np.take_along_axis(uv[face], order[..., None], axis=1)
    edge, side = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = (side * edge).sum(1) / (edge * edge).sum(1)
        height = np.linalg.norm(side - share[:, None] * edge, axis=1)
        moved = -((t[:, 2] - t[:, 0]) - share[:, None] * (t[:, 1] - t[:, 0])) / height[:, None]
    return moved, share, height
