"""Glossy transfer in zonal lobes: the rows of a factored BRDF turn with the surface."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.glossy import GLOSSY_LAYOUTS, Layers
from torchprt.transfer.layout import Layout
from torchprt.transfer.zonal import check_axes, fewer_bands, lobe_order

_REAL = (torch.float32, torch.float64)


@dataclass(kw_only=True)
class ZonalFactoredTransfer(Layers):
    """`FactoredTransfer` whose rows, and the vectors of the diffuse layer, are sums of zonal lobes.

    Row i of the matrix of receiver `glossy[g]` is `M_i,lm = sum_k y_lm(axis_ik) coefficients_ikl`, with bands 0 and 1
    in `exact` if J = 4; exit radiance is `specular * sum_i u_i(v) M_i . light`, v the direction toward the eye in the
    local frame of the deformed surface. All turns with the surface as in `ZonalTransfer`.
    Source: Sloan, Luna and Snyder 2005, section 5.

    - `axis [M, L, 3, G]`, `coefficients [C, M, L, Z, G]`, `exact [C, M, J, G]`: as in `ZonalTransfer`, for each row.
    - `factors [M, H, H]`, `factor_error`: as in `FactoredTransfer`.
    - `diffuse_axis [L', 3, V or 0]`, `diffuse_coefficients [C, L', Z', V or 0]`, `diffuse_exact [C, J', V or 0]`: the
      diffuse layer, as `ZonalTransfer`; no vertices if nothing is diffuse. `diffuse [C, N, 0]` holds nothing.
    - `squared_error [G]`: what the fit costs each glossy receiver, summed over rows and coefficients; `fit_error`: RMS
      over all, relative to the rows; `smooth`: as in `ZonalTransfer`.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "zonal factored"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | {
        "diffuse": Layout(("C", "N", "0")),
        "axis": Layout(("M", "L", "3", "G")),
        "coefficients": Layout(("C", "M", "L", "Z", "G")),
        "exact": Layout(("C", "M", "J", "G")),
        "factors": Layout(("M", "H", "H"), _REAL),
        "diffuse_axis": Layout(("A", "3", "V|0")),
        "diffuse_coefficients": Layout(("C", "A", "B", "V|0")),
        "diffuse_exact": Layout(("C", "E", "V|0")),
        "squared_error": Layout(("G",)),
    }

    axis: Tensor
    coefficients: Tensor
    exact: Tensor
    factors: Tensor
    diffuse_axis: Tensor
    diffuse_coefficients: Tensor
    diffuse_exact: Tensor
    squared_error: Tensor
    factor_error: float | None = None
    smooth: bool = False
    fit_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        layers = [lobe_order(self.coefficients.shape[3], self.exact.shape[2])]
        layers.append(lobe_order(self.diffuse_coefficients.shape[2], self.diffuse_exact.shape[1]))
        if layers != [self.order] * 2:
            raise InputError(
                f"lobes of the transfer are of orders {layers[0]} (glossy) and {layers[1]} (diffuse): "
                f"both must be of the order {self.order} of the light"
            )
        counts = {part.shape[-1] for part in (self.diffuse_axis, self.diffuse_coefficients, self.diffuse_exact)}
        if len(counts) != 1:
            raise InputError(f"lobes of the diffuse layer are for {sorted(counts)} vertices: they must be for the same")

    @property
    def lobes(self) -> int:
        """Number of lobes L a row."""
        return self.axis.shape[1]

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        lobes = self.axis, self.coefficients, self.exact
        return *lobes, self.diffuse_axis, self.diffuse_coefficients, self.diffuse_exact, self.factors

    def check(self) -> None:
        """Raises InputError as the check of `FactoredTransfer`, and if an axis is not of unit length."""
        super().check()
        check_axes("axis", self.axis, 2)
        check_axes("diffuse_axis", self.diffuse_axis, 1)

    def to_order(self, order: int) -> ZonalFactoredTransfer:
        """For lights of the first `order` bands. Raises InputError unless 1 (2 with `exact`) <= order <= self.order."""
        kept = fewer_bands(order, self.order, self.exact.shape[2])
        shared = fewer_bands(order, self.order, self.diffuse_exact.shape[1])
        return dataclasses.replace(
            self,
            diffuse=self.diffuse[:, : order * order].contiguous(),
            coefficients=self.coefficients[..., :kept, :].contiguous(),
            diffuse_coefficients=self.diffuse_coefficients[:, :, :shared].contiguous(),
        )

    def to(self, dtype: torch.dtype) -> ZonalFactoredTransfer:
        """The same with axes and coefficients stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        names = ("axis", "coefficients", "exact", "diffuse_axis", "diffuse_coefficients", "diffuse_exact")
        return dataclasses.replace(self, **{name: getattr(self, name).to(dtype) for name in names})
