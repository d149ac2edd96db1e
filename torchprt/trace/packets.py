"""The engine that hands rays to Embree in packets of neighbouring directions, by way of numba."""

from __future__ import annotations

import functools
import warnings
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, Int32
from torch import Tensor

from torchprt.trace.embree import Embree, Triangles, library
from torchprt.trace.engines import CannotRun, EngineWarning
from torchprt.trace.hits import Hits
from torchprt.trace.rays import in_the_world

# Sets of directions that are held in the order of packets: a bake has one, and the searches before it a few.
HELD = 4


class _Fan(NamedTuple):
    """Directions as given, `[3, R]` in the order of packets, and where each stood."""

    given: Tensor
    ordered: Float32[np.ndarray, "3 R"]
    places: Int32[np.ndarray, "R"]


class Packets:
    """An `Engine`: Embree in robust mode with as many rays a packet as its processor takes at once.

    The rays of one receiver go to Embree in packets of directions that are near each other, and only one packet of them
    is ever in memory. Which rays go together depends on the directions alone, so the answers for a receiver do not
    depend on the others it is asked with.
    """

    # The more receivers, the more are neighbours, which meet the same part of the tree; a task of 1024 rays each.
    at_once = 1 << 19

    def __init__(
        self, vertices: Float32[np.ndarray, "V 3"], faces: Int32[np.ndarray, "F 3"], embree: Embree | None = None
    ) -> None:
        embree = embree or library()
        self._triangles = Triangles(embree, vertices, faces)
        self._lanes = embree.lanes
        self._kernels = _kernels(self._lanes)
        # What all kernels begin with.
        self._occluded = self._tracing(embree, "Occluded")
        self._intersect = self._tracing(embree, "Intersect")
        self._fans: tuple[_Fan, ...] = ()

    def _tracing(self, embree: Embree, what: str) -> tuple[int, int]:
        return embree.addresses[f"rtc{what}{self._lanes}"], self._triangles.pointer

    def visibility(
        self, origins: Float[Tensor, "v *S 3"], frames: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
    ) -> Float32[Tensor, "v D"]:
        """As `Engine.visibility`."""
        answers = np.empty((len(origins), len(directions)), np.float32)
        if not len(origins):
            return torch.from_numpy(answers)
        if len(directions) < self._lanes:
            start, rays = _rows(*in_the_world(origins, frames, directions))
            self._kernels.rays_visible(*self._occluded, start, rays, answers.reshape(-1))
        else:
            self._kernels.visibility(*self._occluded, *self._fanned(origins, frames, directions), answers)
        return torch.from_numpy(answers)

    def hits(
        self, origins: Float[Tensor, "v *S 3"], frames: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
    ) -> Hits:
        """As `Engine.hits`."""
        shape = len(origins), len(directions)
        if len(directions) < self._lanes:
            found = self.nearest(*in_the_world(origins, frames, directions))
            return Hits(*(part.view(shape) for part in vars(found).values()))
        arrays = _empty(shape)
        if len(origins):
            self._kernels.hits(*self._intersect, *self._fanned(origins, frames, directions), *arrays)
        return Hits(*map(torch.from_numpy, arrays))

    def nearest(self, origins: Float32[np.ndarray, "E 3"], directions: Float32[np.ndarray, "E 3"]) -> Hits:
        """As `Engine.nearest`."""
        arrays = _empty((len(origins),))
        self._kernels.rays_hit(*self._intersect, *_rows(origins, directions), *arrays)
        return Hits(*map(torch.from_numpy, arrays))

    def _fanned(self, origins: Tensor, frames: Tensor, directions: Tensor) -> tuple[Any, ...]:
        starts = origins if origins.ndim == 3 else origins[:, None]
        fan = self._fan(directions)
        return receiver_order(starts[:, 0].numpy()), *_rows(starts.numpy(), frames.numpy()), *fan[1:], len(directions)

    def _fan(self, directions: Float[Tensor, "D 3"]) -> _Fan:
        # Threads may add a set at the same time; then one of the two is made again.
        for fan in self._fans:
            if fan.given is directions or torch.equal(fan.given, directions):
                return fan
        places = packet_order(directions.numpy(), self._lanes)
        ordered = np.ascontiguousarray(directions.numpy()[places].T, np.float32)
        fan = _Fan(directions.clone(), ordered, places)
        self._fans = (fan, *self._fans[: HELD - 1])
        return fan


def packet_order(directions: Float[np.ndarray, "D 3"], lanes: int) -> Int32[np.ndarray, "R"]:
    """The order in which every `lanes` directions in turn are near each other; the last one again and again until the
    last packet is full.

    All are cut in two halves across their longest side, and the halves again, down to packets: more compact than
    Morton's order, whose runs of 16 lie across the borders of its cells.
    """
    places = np.arange(len(directions))
    packets = [-(-len(directions) // lanes)]
    while max(packets) > 1:
        ends = np.minimum(np.cumsum(packets) * lanes, len(places))
        first = np.concatenate([[0], ends[:-1]])
        group = np.repeat(np.arange(len(packets)), ends - first)
        ordered = directions[places]
        side = np.maximum.reduceat(ordered, first) - np.minimum.reduceat(ordered, first)
        along = ordered[np.arange(len(places)), side.argmax(1)[group]]
        whole = np.array(packets)[group] == 1
        places = places[np.lexsort((np.where(whole, np.arange(len(places)), along), group))]
        packets = [half for count in packets for half in ((count + 1) // 2, count // 2) if half]
    short = -len(places) % lanes
    return np.concatenate([places, np.repeat(places[-1:], short)]).astype(np.int32)


# The bits of a number of ten with two zeros after each.
_SPREAD = ((np.arange(1 << 10)[:, None] >> np.arange(10) & 1) << 3 * np.arange(10)).sum(1)


def receiver_order(origins: Float32[np.ndarray, "v 3"]) -> Int[np.ndarray, "v"]:
    """The order (Morton's) in which each receiver is near the one before: they meet the same part of the tree."""
    low = origins.min(0)
    extent = (origins.max(0) - low).max()
    if not extent > 0:
        return np.arange(len(origins))
    cells = _SPREAD[((origins - low) * (1023 / extent)).astype(np.int64)]
    return np.argsort(cells @ (1, 2, 4), kind="stable")


def _empty(shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    return tuple(np.empty(shape, kind) for kind in (np.int32, np.float32, np.float32, np.bool_))


def _rows(*arrays: np.ndarray) -> tuple[np.ndarray, ...]:
    """As the kernels are compiled for: other strides or numbers would compile them again."""
    return tuple(np.ascontiguousarray(array, np.float32) for array in arrays)


@functools.cache
def _kernels(lanes: int) -> Any:
    from torchprt.trace import packet_kernels

    try:
        return packet_kernels.kernels(lanes)
    except RuntimeError as fault:
        warnings.warn(
            f"what numba compiles cannot be kept on disk, so that every process spends seconds on it ({fault}): name a "
            "folder that can be written as NUMBA_CACHE_DIR",
            EngineWarning,
            stacklevel=2,
        )
        return packet_kernels.kernels(lanes, kept=False)


def try_on_a_triangle(embree: Embree | None = None) -> None:
    """Whether a library (that of embreex) answers as the layout of packets says. Raises CannotRun if not."""
    embree = embree or library()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
    packets = Packets(corners, np.array([[0, 1, 2]], np.int32), embree)
    start = np.array([[0.25, 0.5, 1], [0.25, 0.5, -1], [2, 2, 1]], np.float32)
    toward = np.array([[0, 0, -1], [0, 0, 1], [0, 0, -1]], np.float32)
    found = packets.nearest(start, toward)
    answers = [part.tolist() for part in vars(found).values()]
    if answers != [[0, 0, -1], [0.25, 0.25, 0], [0.5, 0.5, 0], [True, False, False]]:
        raise CannotRun(f"{embree.path} (Embree {embree.version}) answers {answers} where a triangle is hit twice")
