"""What a glossy receiver records along its directions: the rows of its matrix."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.brdf import Brdf, Factors, exit_kernel
from torchprt.sh import (
    Projection,
    basis,
    exit_count,
    gauss_legendre,
    gauss_legendre_hemisphere,
    hemisphere_basis,
    rotate,
)

Frame = Literal["exit", "factored", "incident", "visibility"]

# Degree of the rule that integrates rows against harmonics where nothing blocks: rows are smooth but at the horizon.
_DEGREE = 96


@dataclass
class Rows:
    """The rows of one material along the directions of a bake, in the local frame.

    - `table [R, D]`: functions of the direction that arriving radiance is integrated with, solid angle included.
    - `product [U, D]`: what visibility is multiplied with to give the U different entries of a matrix, and
      `entries [R * N]`, which of them each entry is (None if they are all different).
    Without an order of the light the product is the table itself: visibility is recorded alone.
    """

    table: Float[Tensor, "R D"]
    product: Float[Tensor, "U D"]
    entries: Int[Tensor, "E"] | None = None

    def shadowed(self, visible: Float[Tensor, "v D"], turned: Float[Tensor, "v 3 3"]) -> Float[Tensor, "v R N"]:
        """Matrices under visibility: rows in the local frame, columns in the world."""
        values = visible @ self.product.T
        if self.entries is not None:
            values = values[:, self.entries]
        return self._to_world(values, turned)

    def unshadowed(self, turned: Float[Tensor, "v 3 3"]) -> Float[Tensor, "v R N"]:
        """Matrices where nothing blocks."""
        values = self.product.sum(-1)
        if self.entries is not None:
            values = values[self.entries]
        return self._to_world(values.expand(len(turned), -1), turned)

    def _to_world(self, values: Tensor, turned: Tensor) -> Tensor:
        local = values.reshape(len(values), len(self.table), -1)
        if local.shape[-1] == 1:
            return local
        return rotate(local.mT.contiguous(), turned.mT.to(local.dtype)).mT


@dataclass(frozen=True)
class Recording:
    """What glossy receivers record: `frame`, and of how many functions of the eye."""

    frame: Frame
    order: int
    output_order: int
    projection: Projection = "optimal"
    factors: Factors | None = None

    @property
    def count(self) -> int:
        """Rows R of a matrix."""
        if self.factors is not None:
            return self.factors.rows
        return exit_count(self.output_order, self.projection if self.frame == "exit" else "optimal")

    @property
    def columns(self) -> int:
        """Columns N of a matrix."""
        return 1 if self.frame == "visibility" else self.order**2

    @property
    def bounces_alike(self) -> bool:
        """Whether what is recorded is also what hits are shaded from."""
        return self.frame == "exit" and self.projection == "optimal"

    def for_hits(self) -> Recording:
        """What must be recorded of surfaces that are hit."""
        return Recording("exit", self.order, self.output_order)

    def rows(self, brdf: Brdf, directions: Float[Tensor, "D 3"]) -> Rows:
        """The rows of a material along `directions`, float32.

        As in `diffuse.projection` all directions share a small correction by which a receiver that nothing blocks
        has exactly the matrix of the closed form.
        """
        if self.frame == "incident":
            return _incident(directions, self.order, self.output_order)
        if self.frame == "visibility":
            return _rows(lambda s: hemisphere_basis(s, self.output_order).T, directions, None)
        if self.factors is not None:
            return _rows(self.factors.kernel, directions, self.order)
        return _rows(lambda s: exit_kernel(brdf, s, self.output_order, self.projection), directions, self.order)


def _rows(kernel: Callable[[Tensor], Tensor], directions: Tensor, order: int | None) -> Rows:
    """All products of a row and a harmonic; the rows themselves without an order."""
    nodes, weights = gauss_legendre_hemisphere(_DEGREE)
    exact = (kernel(nodes) * weights) @ _harmonics(nodes, order)
    table = kernel(directions) * (2 * math.pi / len(directions))
    harmonics = _harmonics(directions, order)
    correction = ((exact - table @ harmonics) / len(directions)).to(torch.float32)
    single = table.to(torch.float32)
    product = single[:, None] * harmonics.T.to(torch.float32).contiguous() + correction[..., None]
    return Rows(single, product.flatten(0, 1))


def around(directions: Float[Tensor, "D 3"], order: int, output_order: int) -> Rows:
    """The rows of what arrives from all around, along `directions` that are spread over the whole sphere."""
    return _pairs(directions, order, output_order, gauss_legendre(order + output_order), 4 * math.pi)


def _incident(directions: Tensor, order: int, output_order: int) -> Rows:
    """Of what arrives at a surface."""
    return _pairs(directions, order, output_order, gauss_legendre_hemisphere(order + output_order), 2 * math.pi)


def _pairs(directions: Tensor, order: int, output_order: int, rule: tuple[Tensor, Tensor], area: float) -> Rows:
    """`y_i y_j` for every pair of harmonics, once: symmetric as far as the matrix is square. `rule`: of quadrature over
    the `area` that the directions are spread over."""
    rows, columns = output_order**2, order**2
    first = torch.arange(rows)[:, None].expand(rows, columns)
    second = torch.arange(columns).expand(rows, columns)
    names = torch.minimum(first, second) * max(rows, columns) + torch.maximum(first, second)
    kept, entries = torch.unique(names, return_inverse=True)
    low, high = kept // max(rows, columns), kept % max(rows, columns)

    def pairs(points: Tensor) -> Tensor:
        values = basis(points, max(order, output_order)).T
        return values[low] * values[high]

    nodes, weights = rule
    solid_angle = area / len(directions)
    product = pairs(directions) * solid_angle
    correction = (pairs(nodes) @ weights - product.sum(-1)) / len(directions)
    table = basis(directions, output_order).T * solid_angle
    return Rows(table.to(torch.float32), (product + correction[:, None]).to(torch.float32), entries.flatten())


def _harmonics(directions: Tensor, order: int | None) -> Tensor:
    if order is None:
        return torch.ones(len(directions), 1, dtype=directions.dtype)
    return basis(directions, order)
