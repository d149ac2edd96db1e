"""Vertices at one position are one place: how seams stop being holes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


def weld(positions: Float[np.ndarray, "V 3"]) -> Int[np.ndarray, "V"]:
    """The place of every vertex: vertices with exactly the same position share a number from 0 up.

    Equality is exact, so that the answer does not depend on the scale of the mesh or on where it stands.
    """
    order = np.lexsort(positions.T)
    ordered = positions[order]
    starts = np.any(ordered[1:] != ordered[:-1], axis=1)
    place = np.empty(len(positions), dtype=np.int64)
    place[order] = np.concatenate([[0], np.cumsum(starts)])[: len(positions)]
    return place


@dataclass(frozen=True, eq=False)
class Edges:
    """Sides of faces, sorted so that sides between the same two places follow each other.

    Side `j` (0, 1, 2) of face `f` runs from corner `j` to corner `j + 1`.
    """

    face: Int[np.ndarray, "E"]
    side: Int[np.ndarray, "E"]
    forward: Bool[np.ndarray, "E"]
    """Whether the side runs from the lower place to the higher."""
    start: Int[np.ndarray, "U"]
    """Where each run of sides between the same two places begins."""
    count: Int[np.ndarray, "U"]
    """How many sides are in it: 1 on a boundary, 2 inside a surface, more where it is not a manifold."""


def edges(welded: Int[np.ndarray, "F 3"]) -> Edges:
    """The edges of faces over places; sides that begin and end at the same place are left out."""
    tail = welded.ravel()
    head = np.roll(welded, -1, axis=1).ravel()
    real = np.flatnonzero(tail != head)
    tail, head = tail[real], head[real]
    places = int(welded.max(initial=0)) + 1
    key = np.minimum(tail, head) * places + np.maximum(tail, head)
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    start = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])[: len(ordered)])
    count = np.diff(np.append(start, len(ordered)))
    corner = real[order]
    return Edges(corner // 3, corner % 3, (tail < head)[order], start, count)
