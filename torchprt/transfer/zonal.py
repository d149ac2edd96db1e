"""A signal in zonal lobes: it turns with the surface, by turning a few axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import Layout
from torchprt.transfer.signal import Signal, check_counts, columns_of


@dataclass(kw_only=True, repr=False)
class Zonal(Signal):
    """Transfer vectors, or the M rows of transfer matrices, as sums of `L` zonal lobes each, for surfaces that deform.

    Row i of receiver g is `t_lm = sum_k y_lm(axis_ik) coefficients_ikl`; with `exact` (J = 4) the bands 0 and 1 are
    those four SH coefficients, and the lobes begin at band 2. A receiver that deformation turns by R has the axes
    `R axis` and the same coefficients; the exact linear band turns as the vector that it is. Lobes are circularly
    symmetric: turned transfer stays exact, shadows do not change with the pose. A receiver without any light has zero
    coefficients and any axes.
    Source: Sloan, Luna and Snyder 2005, sections 4 to 6.

    - `axis [M, L, 3, G]`: unit vectors in the frame of the rest pose, the world of the bake; channels share them.
    - `coefficients [C, M, L, Z, G]`: Z = order bands, or order - 2 with `exact`. They are g*_l: SH coefficients over
      y_lm(axis), `sqrt(4 pi / (2 l + 1))` times zonal coefficients.
    - `exact [C, M, J, G]`, J = 0 or 4: the first SH coefficients of the rest pose, stored apart.
    - `squared_error [G]`: what the fit costs each receiver, summed over rows and coefficients; `fit_error`: RMS over
      all, relative to the transfer. `smooth`: lobes of neighbours correspond, so they may be interpolated.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "zonal"
    layouts: ClassVar[dict[str, Layout]] = {
        "axis": Layout(("M", "L", "3", "G")),
        "coefficients": Layout(("C", "M", "L", "Z", "G")),
        "exact": Layout(("C", "M", "J", "G")),
        "squared_error": Layout(("G",)),
    }
    stored: ClassVar[tuple[str, ...]] = ("coefficients", "axis", "exact")
    follows_pose: ClassVar[bool] = True

    axis: Tensor
    coefficients: Tensor
    exact: Tensor
    squared_error: Tensor
    smooth: bool = False
    fit_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        apart = self.exact.shape[2]
        if apart not in (0, 4):
            raise InputError(f"exact of the transfer holds {apart} coefficients: it must be 0, or 4 (bands 0 and 1)")
        if self.order == 0:
            raise InputError("coefficients of the transfer have no band: it must have one or more")
        check_counts(self.coefficients.shape[0], self.order**2)

    @property
    def order(self) -> int:
        """Number of SH bands."""
        return self.coefficients.shape[3] + (2 if self.exact.shape[2] else 0)

    @property
    def lobes(self) -> int:
        """Number of lobes L a row."""
        return self.axis.shape[1]

    @property
    def shape(self) -> tuple[int, int, int, int]:
        channels, rows, _, _, receivers = self.coefficients.shape
        return receivers, channels, rows, self.order**2

    def to_order(self, order: int) -> Zonal:
        """InputError below order 2 with `exact`, which would have to be cut."""
        apart = 2 if self.exact.shape[2] else 0
        columns_of(order, self.order, max(1, apart))
        return self.replace(coefficients=self.coefficients[..., : order - apart, :].contiguous())

    def take(self, index: Int[Tensor, "g"]) -> Zonal:
        return self.replace(
            **{name: value.index_select(-1, index).contiguous() for name, value in self.tensors().items()}
        )

    def check(self, of: str = "") -> None:
        """InputError if a tensor holds NaN or infinity, or an axis is not of unit length within 1e-4 (or the rounding
        of its dtype)."""
        super().check(of)
        off = (torch.linalg.vector_norm(self.axis.double(), dim=2) - 1).abs()
        bad = int((off > max(1e-4, 2 * torch.finfo(self.axis.dtype).eps)).sum())
        if bad:
            raise InputError(f"axis of the transfer holds {bad} vectors that are not of unit length: fit it again")
