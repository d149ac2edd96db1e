"""What an object does to the light around it: a matrix at each node of a grid, for receivers that are not known yet."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layer import Layer


@dataclass(kw_only=True, repr=False)
class Neighbourhood(Layer):
    """Source to transferred incident radiance around an object, over the whole sphere.

    Under a light `l [N, 3]` in the frame of the object the radiance that arrives at a node from the direction s has the
    SH coefficients `sum_j M_ij l_j`, i < `output_order`^2: M_ij = int V y_i y_j ds where V is what the object lets
    through, plus what it reflects and sends toward the node. Far from the object M is the identity. The rows stand in
    the frame of the object, whichever way it turns. Receivers read the matrices between nodes, with a normal and a
    reflectance, or transfer, of their own (`shade.NeighbourhoodShader`): by itself it has no exit radiance.

    - `inside`: how many nodes lie in the object and see nothing of the world; they continue those around them.
    - `interpolation_error`: relative RMS error of the radiance of diffuse receivers that face along the six axes, under
      lights that are white over N, in the middle of cells, where it is read from the nodes around them: in cells that
      the object takes or adds 2 % in, and that its surface does not pass through. The error of the rays is in it.

    Raises InputError if its rows are not the square of an order, have more bands than the light, or its signal is in
    lobes, which turn with a surface.
    Source: Sloan, Kautz and Snyder 2002, section 8.
    """

    kind: ClassVar[str] = "neighbourhood"
    needs: ClassVar[frozenset[str]] = frozenset({"receivers"})
    matrices: ClassVar[bool] = True
    weight_name: ClassVar[str] = "weight"

    inside: int = 0
    interpolation_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.signal.follows_pose:
            raise InputError("a neighbourhood stands in the frame of its object: its signal cannot be in lobes")
        _, _, rows, columns = self.signal.shape
        if rows == 0 or self.output_order**2 != rows:
            raise InputError(f"signal of the transfer has {rows} rows: it must be the square of the output order")
        if rows > columns:
            raise InputError(
                f"output order {self.output_order} of the transfer is above the order {self.order} of the light: "
                "lower it"
            )
        if self.receivers is not None:
            raise InputError("a neighbourhood is about all nodes of its grid: leave receivers out")

    @property
    def weight(self) -> Tensor:
        """One: nothing weighs what arrives."""
        return torch.ones(1, 1)

    @property
    def output_order(self) -> int:
        """Number of SH bands of transferred radiance."""
        return math.isqrt(self.signal.shape[2])
