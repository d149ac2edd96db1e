"""The data that are clustered, made ready for it: checked, centred, of unit size, in few dimensions."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torchprt.errors import InputError

# Clusters are sought in so many dimensions; what lies outside of the principal ones hardly tells them apart.
DIMENSIONS = 128
_SAMPLE = 1 << 14
_STEP = 1 << 15


def check(data: Tensor, clusters: int, iterations: int) -> None:
    """InputError if `data [V, S]` cannot be put in `clusters`."""
    if data.dtype not in (torch.float32, torch.float64):
        raise InputError(f"data is {data.dtype}: pass float32 or float64")
    if data.ndim != 2 or data.shape[1] == 0:
        raise InputError(f"data has shape {tuple(data.shape)}: it must be [points, numbers a point], with numbers")
    if clusters < 1:
        raise InputError(f"clusters is {clusters}: there must be at least one")
    if clusters > len(data):
        raise InputError(f"clusters is {clusters}, but there are only {len(data)} points: ask for fewer")
    if iterations < 1:
        raise InputError(f"iterations is {iterations}: there must be at least one")
    finite = torch.stack([some.isfinite().all() for some in data.split(_STEP)])
    if not finite.all():
        row = int((~data.isfinite()).any(1).nonzero()[0, 0])
        raise InputError(f"data holds a number that is not finite, first in row {row}: mend the transfer it is from")


@dataclass(frozen=True)
class Normal:
    """How points become those that clusters are sought among: less `centre [S]`, over `size`, in `axes [S, D]`."""

    centre: Tensor
    size: float
    axes: Tensor | None

    def of(self, data: Tensor) -> Tensor:
        """`[V, D]`, of the dtype of `data`: a row of each point, whichever others there are."""
        points = data.new_empty(len(data), data.shape[1] if self.axes is None else self.axes.shape[1])
        for some, out in zip(data.split(_STEP), points.split(_STEP), strict=True):
            centred = (some.double() - self.centre) / self.size
            out.copy_(centred if self.axes is None else (centred.to(data.dtype) @ self.axes))
        return points


def normal_of(data: Tensor) -> Normal:
    """That with which `data` has mean 0 and unit size, in its principal axes if S is large."""
    centre = sum((some.double().sum(0) for some in data.split(_STEP)), start=data.new_zeros((), dtype=torch.float64))
    centre = centre / len(data)
    # Squares of numbers of any size must neither vanish nor overflow.
    size = max(float((some.double() - centre).abs().amax()) for some in data.split(_STEP)) or 1.0
    return Normal(centre, size, _principal_axes(data, centre, size) if data.shape[1] > DIMENSIONS else None)


def normalised(data: Tensor) -> Tensor:
    """`[V, D]`: `data` that was checked, less its mean, of unit size; D = S, or the principal axes if S is larger."""
    return normal_of(data).of(data)


def _principal_axes(data: Tensor, centre: Tensor, size: float) -> Tensor:
    """`[S, DIMENSIONS]` orthonormal, from evenly chosen rows, by block power iteration from a fixed random start.

    Halko, Martinsson and Tropp 2011, algorithm 4.4. Only clusters are sought in these axes: no figure depends on how
    exact they are.
    """
    some = data[:: -(-len(data) // _SAMPLE)]
    some = ((some.double() - centre) / size).to(data.dtype)
    generator = torch.Generator().manual_seed(0)
    axes = torch.randn(data.shape[1], DIMENSIONS, generator=generator, dtype=torch.float64, device="cpu").to(some)
    for _ in range(4):
        axes = torch.linalg.qr((some.mT @ (some @ axes)).double()).Q.to(some)
    return axes
