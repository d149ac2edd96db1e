"""Axes that all clusters share: representatives as a few numbers each, bases of two levels."""

from __future__ import annotations

import torch
from torch import Tensor

from torchprt.compression.importance import root_of
from torchprt.compression.subspaces import one_thread
from torchprt.errors import InputError

_STEP = 1 << 14


def moments(data: Tensor, root: Tensor | None = None) -> Tensor:
    """`[S, S]` float64: the second moments of points, not about their mean, under the importance `root root^T`."""
    total = data.new_zeros(data.shape[1], data.shape[1], dtype=torch.float64)
    with one_thread():
        for some in data.split(_STEP):
            points = some.double() if root is None else some.double() @ root
            total.addmm_(points.mT, points)
    return total


def shared_axes(data: Tensor, count: int, importance: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Axes `[Q, S]` and the coordinates of all points in them, `[V, Q]`: `coordinates @ axes` is nearest to `data`.

    Nearest in the sense of `importance`, under which the axes are orthonormal: plain distances of coordinates are the
    weighed ones of points. Found in float64, in the dtype of `data`.
    Raises InputError if there are more axes than numbers a point.
    """
    axes, into = axes_of(data, count, importance)
    return axes, coordinates_of(data, into)


def axes_of(data: Tensor, count: int, importance: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Axes `[Q, S]` as `shared_axes` has them, and `into [S, Q]` float64 with `data @ into` the coordinates."""
    if not 1 <= count <= data.shape[1]:
        raise InputError(f"shared is {count}, but a point has {data.shape[1]} numbers: ask for 1 to so many axes")
    root = None if importance is None else root_of(importance, data)
    _, vectors = torch.linalg.eigh(moments(data, root))
    vectors = vectors.flip(1)[:, :count]
    into = vectors if root is None else root @ vectors
    axes = vectors.mT if root is None else torch.linalg.solve(root, vectors.mT, left=False)
    return axes.to(data.dtype), into


def coordinates_of(data: Tensor, into: Tensor) -> Tensor:
    """`data @ into`, `[V, Q]` of the dtype of `data`."""
    coordinates = data.new_empty(len(data), into.shape[1])
    with one_thread():
        for some, out in zip(data.split(_STEP), coordinates.split(_STEP), strict=True):
            out.copy_(some.double() @ into)
    return coordinates
