"""Cells of a volume: where what is scattered inside of it is recorded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.grid import placed
from torchprt.transfer.layout import REAL, WHOLE, Layout, check_indices
from torchprt.transfer.receivers import Receivers


@dataclass(kw_only=True, repr=False)
class Cells(Receivers):
    """The cells of a regular grid that hold anything: the others are as air, and cost nothing.

    - `shape`: how many cells along x, y and z; cell (i, j, k) has the number (i ny + j) nz + k and fills the box from
      `origin + (i, j, k) * spacing` to a `spacing` beyond, both three numbers, in the world.
    - `cells [V]`: the numbers of the receivers, ascending.
    - `extinction [V]`: what is taken from light a unit of the world's length, constant in a cell: e^(-extinction d) of
      it is left after a way of d.

    What a layer of them sends is the source radiance J of the cell: a ray that crosses it by a way of d gains
    `(1 - e^(-extinction d)) J`. There is no surface: normals are zero, and there are no faces.
    Raises InputError for other shapes, spacings that are not above zero, or numbers that are not finite.
    Source: Sloan, Kautz and Snyder 2002, section 7.
    """

    kind: ClassVar[str] = "cells"
    on_surface: ClassVar[bool] = False
    layouts: ClassVar[dict[str, Layout]] = {"cells": Layout(("V",), WHOLE), "extinction": Layout(("V",), REAL)}

    shape: Sequence[int]
    origin: Sequence[float]
    spacing: Sequence[float]
    cells: Tensor
    extinction: Tensor
    positions: Any = None
    normals: Any = None
    faces: Any = None

    def __post_init__(self) -> None:
        super().__post_init__()
        place = placed("volume", self.shape, self.origin, self.spacing, "cells", 1)
        self.shape, self.origin, self.spacing = place
        check_indices("cells", self.cells, math.prod(self.shape))
        device = self.cells.device
        step = torch.tensor(self.spacing, dtype=torch.float64, device=device)
        corner = torch.tensor(self.origin, dtype=torch.float64, device=device)
        self.positions = (corner + (self.places() + 0.5) * step).to(torch.float32)
        self.normals = torch.zeros(self.count, 3, device=device)
        self.faces = torch.zeros(0, 3, dtype=torch.int32, device=device)

    @property
    def count(self) -> int:
        return len(self.cells)

    def metadata(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("shape", "origin", "spacing")}

    def places(self) -> Float[Tensor, "V 3"]:
        """Which cells they are, i, j and k, float64."""
        _, ny, nz = self.shape
        number = self.cells.long()
        return torch.stack([number // (ny * nz), number // nz % ny, number % nz], -1).to(torch.float64)

    @property
    def box(self) -> tuple[list[float], list[float]]:
        """The lowest and the highest corner of the whole grid."""
        high = [low + step * count for low, step, count in zip(self.origin, self.spacing, self.shape, strict=True)]
        return list(self.origin), high

    @property
    def subject(self) -> Float[Tensor, "S 3"]:
        """What pictures frame: the corners of those that hold anything, of each column along z of its two ends."""
        places = self.places()
        if not len(places):
            places = torch.zeros(1, 3, dtype=torch.float64, device=self.cells.device)
        # They ascend, z the fastest.
        _, counts = torch.unique_consecutive(places[:, :2], dim=0, return_counts=True)
        last = counts.cumsum(0) - 1
        sides = torch.tensor([0.0, 1.0], dtype=torch.float64, device=places.device)
        corners = torch.cartesian_prod(sides, sides, sides)
        ends = torch.cat([places[last - counts + 1], places[last]]).unsqueeze(1) + corners
        low, step = (places.new_tensor(each) for each in (self.origin, self.spacing))
        return (low + ends.flatten(0, 1) * step).to(torch.float32)

    def dense(self, values: Float[Tensor, "*B V"]) -> Float[Tensor, "*B X Y Z"]:
        """Values of the receivers as those of all cells, zero where there is nothing."""
        whole = values.new_zeros(*values.shape[:-1], math.prod(self.shape))
        whole[..., self.cells.long()] = values
        return whole.unflatten(-1, tuple(self.shape))

    def as_cells(self) -> Cells:
        return self

    def check(self, of: str = "") -> None:
        """InputError if a tensor holds NaN or infinity, extinction is below zero, or the cells do not ascend."""
        super().check(of)
        if bool((self.extinction < 0).any()):
            raise InputError("extinction of the transfer is below zero: bake it again")
        if self.count > 1 and not bool((self.cells[1:] > self.cells[:-1]).all()):
            raise InputError("cells of the transfer must be in ascending order, each once: bake it again")
