"""Nodes around an object: where what it does to light is recorded, for receivers that come later."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.receivers import Receivers


@dataclass(kw_only=True, repr=False)
class Grid(Receivers):
    """The nodes of a regular grid around an object, in the frame of the object at rest.

    - `shape`: how many nodes along x, y and z, two or more each; node (i, j, k) is receiver (i ny + j) nz + k and
      stands at `origin + (i, j, k) * spacing`, both three numbers.
    - `share`: how the grid was placed: it was grown until beyond it the object takes less than this share of the
      irradiance of a receiver that faces up (+y) under a white light; None if whoever baked it gave the place.
      `border`: the largest share that was found on its border.

    There is nothing to draw: normals are zero, and there are no faces.
    Raises InputError for other shapes, spacings that are not above zero, or numbers that are not finite.
    """

    kind: ClassVar[str] = "grid"

    shape: Sequence[int]
    origin: Sequence[float]
    spacing: Sequence[float]
    share: float | None = None
    border: float | None = None
    positions: Any = None
    normals: Any = None
    faces: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        place = placed("grid", self.shape, self.origin, self.spacing, "nodes", 2)
        self.shape, self.origin, self.spacing = place
        self.positions = self.places()
        self.normals = torch.zeros(self.count, 3)
        self.faces = torch.zeros(0, 3, dtype=torch.int32)

    def metadata(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("shape", "origin", "spacing", "share", "border")}

    def places(self, shift: float = 0.0) -> Float[Tensor, "V 3"]:
        """Where the nodes are, float64; with a `shift` of .5 the middles of the cells, which are one fewer a side."""
        counts = [count - (shift > 0) for count in self.shape]
        axes = [
            first + step * (torch.arange(count, dtype=torch.float64) + shift)
            for count, first, step in zip(counts, self.origin, self.spacing, strict=True)
        ]
        return torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)

    @property
    def box(self) -> tuple[list[float], list[float]]:
        """The lowest and the highest corner."""
        last = [
            first + step * (count - 1) for first, step, count in zip(self.origin, self.spacing, self.shape, strict=True)
        ]
        return list(self.origin), last

    def as_grid(self) -> Grid:
        return self


def placed(
    name: str, shape: Sequence[int], origin: Sequence[float], spacing: Sequence[float], pieces: str, least: int
) -> tuple[list[int], list[float], list[float]]:
    """Three counts of the `pieces` of a grid, its origin and spacing, as plain lists.

    Raises InputError unless there are three of each, the counts not below `least`, and they are finite, spacings above
    zero.
    """
    counts, corner, step = [int(count) for count in shape], list(map(float, origin)), list(map(float, spacing))
    if len(counts) != 3 or min(counts) < least:
        raise InputError(f"{name} of the transfer has {counts} {pieces}: give three counts of {least} or more")
    if len(corner) != 3 or len(step) != 3 or not all(map(math.isfinite, corner + step)):
        raise InputError(f"{name} of the transfer stands nowhere: origin and spacing must be three finite numbers each")
    if min(step) <= 0:
        raise InputError(f"{name} of the transfer has the spacing {step}: it must be above zero")
    return counts, corner, step


def grid_in(low: Sequence[float], high: Sequence[float], shape: Sequence[int], **known: Any) -> Grid:
    """The grid of `shape` nodes whose outermost ones lie on a box.

    Raises InputError as `Grid`, or if the box is empty.
    """
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise InputError(
            f"box from {list(low)} to {list(high)} is empty: give x0,y0,z0,x1,y1,z1, the lower corner first"
        )
    spacing = [(b - a) / max(count - 1, 1) for a, b, count in zip(low, high, shape, strict=True)]
    return Grid(shape=shape, origin=low, spacing=spacing, **known)
