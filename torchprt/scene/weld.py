"""Vertices at one position are one place: how seams stop being holes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int


def weld(positions: Float[np.ndarray, "V 3"]) -> Int[np.ndarray, "V"]:
    """The place of every vertex: vertices with exactly the same position share a number from 0 up.

    Equality is exact, so that the answer does not depend on the scale of the mesh or on where it stands.
    """
    if not len(positions):
        return np.zeros(0, dtype=np.int64)
    last = positions[:, -1]
    order = np.argsort(last)
    # Most meshes have few vertices of one height that are not copies: only those are sorted by all coordinates.
    ordered = positions[order]
    ordered = _by_all(ordered, order)
    starts = np.any([column[1:] != column[:-1] for column in ordered.T], axis=0)
    place = np.empty(len(positions), dtype=np.int64)
    place[order[0]] = 0
    place[order[1:]] = np.cumsum(starts)
    return place


def _by_all(ordered: Float[np.ndarray, "V 3"], order: Int[np.ndarray, "V"]) -> Float[np.ndarray, "V 3"]:
    """Rows that are in the order of their last number, in that of all, the last first; `order` goes along in place."""
    new_level = ordered[1:, -1] != ordered[:-1, -1]
    mixed = ~new_level & np.any([column[1:] != column[:-1] for column in ordered.T[:-1]], axis=0)
    if not mixed.any():
        return ordered
    level = np.concatenate([[0], np.cumsum(new_level)])
    unsorted = np.zeros(level[-1] + 1, dtype=bool)
    unsorted[level[1:][mixed]] = True
    rows = np.flatnonzero(unsorted[level])
    within = rows[np.lexsort((*ordered[rows].T[:-1], level[rows]))]
    order[rows] = order[within]
    ordered[rows] = ordered[within]
    return ordered


@dataclass(frozen=True, eq=False)
class Edges:
    """Sides of faces, sorted so that sides between the same two places follow each other.

    Side `j` (0, 1, 2) of face `f` runs from corner `j` to corner `j + 1`.
    """

    corner: Int[np.ndarray, "E"]
    """Where each side begins: corner `j` of face `f` is `3 f + j`."""
    forward: Bool[np.ndarray, "E"]
    """Whether the side runs from the lower place to the higher."""
    start: Int[np.ndarray, "U"]
    """Where each run of sides between the same two places begins."""
    count: Int[np.ndarray, "U"]
    """How many sides are in it: 1 on a boundary, 2 inside a surface, more where it is not a manifold."""

    @cached_property
    def face(self) -> Int[np.ndarray, "E"]:
        """The face of every side."""
        return self.corner // 3

    @cached_property
    def side(self) -> Int[np.ndarray, "E"]:
        """Which side of its face it is."""
        return self.corner % 3


def edges(welded: Int[np.ndarray, "F 3"]) -> Edges:
    """The edges of faces over places; sides that begin and end at the same place are left out."""
    tail = welded.ravel()
    head = np.empty_like(welded)
    head[:, :2], head[:, 2] = welded[:, 1:], welded[:, 0]
    head = head.ravel()
    forward = tail < head
    key = np.where(forward, tail, head)
    key *= int(welded.max(initial=0)) + 1
    key += np.where(forward, head, tail)
    real = tail != head
    if real.all():
        corner, ordered = _ordered(key)
    else:
        kept = np.flatnonzero(real)
        corner, ordered = _ordered(key[kept])
        corner = kept[corner]
    start = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])[: len(ordered)])
    count = np.diff(np.append(start, len(ordered)))
    return Edges(corner, forward[corner], start, count)


def _ordered(key: Int[np.ndarray, "E"]) -> tuple[Int[np.ndarray, "E"], Int[np.ndarray, "E"]]:
    """The stable order of `key`, which is not negative, and `key` in it."""
    below = max(len(key) - 1, 1).bit_length()
    if int(key.max(initial=0)).bit_length() + below > 63:
        order = np.argsort(key, kind="stable")
        return order, key[order]
    # Keys with their number in the lower bits are different: any sort of them is stable, and none moves two arrays.
    packed = np.sort((key << below) | np.arange(len(key)))
    return packed & ((1 << below) - 1), packed >> below


@dataclass(frozen=True, eq=False)
class Joined:
    """Faces over places: what the normals and the report of a mesh both ask for, sorted once."""

    place: Int[np.ndarray, "V"]
    """See `weld`."""
    repeated: int
    """Vertices at the position of an earlier one."""
    faces: Int[np.ndarray, "F 3"]
    """Corners by their places; by their vertices if none is repeated, whose numbers lie closer together in memory."""

    @cached_property
    def edges(self) -> Edges:
        """The edges of `faces`."""
        return edges(self.faces)


def join(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Joined:
    """`faces` over the places of `positions`."""
    place = weld(positions)
    repeated = len(place) - int(place.max(initial=-1) + 1)
    return Joined(place, repeated, place[faces] if repeated else faces)
