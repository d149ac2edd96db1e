"""What light goes through: a grid of extinction and albedo."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch import Tensor

from torchprt.errors import InputError

from .material import Numbers, check_albedo, table


@dataclass(frozen=True, eq=False, repr=False)
class Volume:
    """A cloud, smoke, fog: cells of a regular grid, each uniform.

    - `extinction [X, Y, Z]`: what a cell takes from light a unit of the world's length, by absorbing and by scattering
      it, 0 where there is nothing: a way of d through it leaves e^(-extinction d).
    - `albedo`: the share of it that is scattered, in [0, 1]: one number, three (linear RGB), or a tensor
      [X, Y, Z, 1 or 3].
    - `origin`: the lowest corner of the grid in the world; `spacing`: the size of a cell, one number or one an axis.
    - `phase`: 0 if it scatters light alike in all directions, or the mean cosine of the angle by which light is turned,
      in (-1, 1), above zero if most of it goes on forward (Henyey and Greenstein; clouds have .85); or the Legendre
      moments of any other phase function, the first of which is 1.

    Raises InputError if extinction is below zero or not finite, nothing is in it, an albedo is outside [0, 1], or the
    grid has no extent.
    """

    extinction: Float32[Tensor, "X Y Z"]
    albedo: Float32[Tensor, "rows C"]
    """[1, C], or a row a cell, number (i Y + j) Z + k."""
    origin: tuple[float, float, float]
    spacing: tuple[float, float, float]
    moments: tuple[float, ...]
    """Of the phase function up to order 64: g^l; one where it is isotropic."""
    name: str

    def __init__(
        self,
        extinction: Tensor | np.ndarray,
        albedo: Numbers = 1.0,
        origin: Sequence[float | int] = (0.0, 0.0, 0.0),
        spacing: float | int | Sequence[float | int] = 1.0,
        phase: float | int | Sequence[float | int] = 0.0,
        name: str = "volume",
    ) -> None:
        put = object.__setattr__
        put(self, "name", name)
        put(self, "extinction", _extinction(extinction, name))
        put(self, "albedo", _albedo(albedo, tuple(self.extinction.shape), name))
        put(self, "origin", _three(origin, f"origin of {name}"))
        put(self, "spacing", _three((spacing,) * 3 if isinstance(spacing, float | int) else spacing, "spacing"))
        if min(self.spacing) <= 0:
            raise InputError(f"{name} has no extent: its spacing is {list(self.spacing)}, give numbers above zero")
        put(self, "moments", phase_moments(phase, name))

    def __repr__(self) -> str:
        """What it is in a line, not all its numbers."""
        cells, held = "x".join(map(str, self.shape)), int(self.occupied.sum())
        cosine = self.moments[1] if len(self.moments) > 1 else 0.0
        return f"Volume({self.name!r}, {cells} cells, {held} of them hold something, mean cosine {cosine:g})"

    @property
    def shape(self) -> tuple[int, int, int]:
        """How many cells along x, y and z."""
        x, y, z = self.extinction.shape
        return x, y, z

    @property
    def occupied(self) -> Bool[Tensor, "X Y Z"]:
        """Which cells hold anything."""
        return self.extinction > 0

    @property
    def isotropic(self) -> bool:
        """Whether it scatters light alike in all directions."""
        return not any(self.moments[1:])

    @property
    def coloured(self) -> bool:
        """Whether light that it scatters changes colour."""
        return bool((self.albedo != self.albedo[:, :1]).any())


MOMENTS = 64
"""Bands of a phase function that are kept: what a light can have."""


def phase_moments(phase: float | int | Sequence[float | int], name: str = "volume") -> tuple[float, ...]:
    """Legendre moments of a phase function, the first 1: those of Henyey and Greenstein's for one number.

    Raises InputError if the number is outside (-1, 1), or the moments are none of a phase function.
    """
    if isinstance(phase, float | int):
        if not -1 < phase < 1:
            raise InputError(f"phase of {name} is {phase:g}: give the mean cosine of its scattering, in (-1, 1)")
        return tuple(float(phase) ** band for band in range(MOMENTS)) if phase else (1.0,)
    moments = tuple(float(each) for each in phase)
    if not moments or moments[0] != 1 or not all(math.isfinite(each) and abs(each) <= 1 for each in moments):
        raise InputError(f"phase of {name} has the moments {list(moments)}: the first is 1, and none is larger")
    return moments[:MOMENTS]


def _extinction(values: Tensor | np.ndarray, name: str) -> Float32[Tensor, "X Y Z"]:
    given = torch.as_tensor(values).detach().cpu()
    if given.ndim != 3 or 0 in given.shape:
        raise InputError(f"{name} has extinction of shape {list(given.shape)}: give [X, Y, Z], one cell or more a side")
    extinction = given.to(torch.float32)
    bad = int((~extinction.isfinite()).sum())
    if bad:
        raise InputError(f"{name} has {bad} cells whose extinction is NaN or infinite: give finite numbers")
    if bool((extinction < 0).any()):
        raise InputError(f"{name} has extinction down to {float(extinction.min()):g}: give 0 where there is nothing")
    if not bool((extinction > 0).any()):
        raise InputError(f"{name} is empty: its extinction is 0 everywhere")
    return extinction.contiguous()


def _albedo(values: Numbers, shape: tuple[int, ...], name: str) -> Float32[Tensor, "rows C"]:
    if isinstance(values, Tensor | np.ndarray) and values.ndim == 4:
        if tuple(values.shape[:3]) != shape or values.shape[3] not in (1, 3):
            raise InputError(
                f"albedo of {name} has shape {list(values.shape)} for {list(shape)} cells: give [X, Y, Z, 1 or 3]"
            )
        values = torch.as_tensor(values).reshape(-1, values.shape[3])
    albedo = table(values, f"albedo of {name}")
    if len(albedo) not in (1, math.prod(shape)):
        raise InputError(f"albedo of {name} has {len(albedo)} rows for {list(shape)} cells: give one, or one a cell")
    check_albedo(albedo, f"albedo of {name}")
    return albedo


def _three(values: Sequence[float | int], what: str) -> tuple[float, float, float]:
    numbers = tuple(float(each) for each in values)
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
        raise InputError(f"{what} is {list(numbers)}: give three finite numbers")
    return numbers[0], numbers[1], numbers[2]
