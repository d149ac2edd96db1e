"""Transfer in zonal lobes: it turns with the surface, by turning a few axes."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import Layout, check_finite, check_layouts
from torchprt.transfer.provenance import Provenance


@dataclass(kw_only=True)
class ZonalTransfer(Provenance):
    """Diffuse transfer of `V` receivers as sums of `L` zonal lobes, for surfaces that deform.

    The transfer vector of receiver v is `t_lm = sum_k y_lm(axis_k) coefficients_kl`; with `exact` (J = 4) the bands 0
    and 1 are those four SH coefficients, and the lobes begin at band 2. A receiver that deformation turns by R has the
    axes `R axis` and the same coefficients; the exact linear band turns as the vector that it is. Exit radiance is
    `albedo * t . light`, as of `DiffuseTransfer`. Lobes are circularly symmetric: turned transfer stays exact, shadows
    do not change with the pose. A receiver without any light has zero coefficients and any axes.
    Source: Sloan, Luna and Snyder 2005, sections 4 and 6.

    - `axis [L, 3, V]`: unit vectors in the frame of the rest pose, the world of the bake; channels share them.
    - `coefficients [C, L, Z, V]`: Z = order bands, or order - 2 with `exact`. They are g*_l: SH coefficients over
      y_lm(axis), `sqrt(4 pi / (2 l + 1))` times zonal coefficients.
    - `exact [C, J, V]`, J = 0 or 4: the first SH coefficients of the rest pose, stored apart.
    - `squared_error [V]`: what the fit costs each receiver, summed over its coefficients; `fit_error`: RMS over all,
      relative to the transfer. `smooth`: lobes of neighbours correspond, so they may be interpolated.
    - `albedo`, `positions`, `normals`, `faces`: as in `DiffuseTransfer`, of the rest pose.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "zonal"
    layouts: ClassVar[dict[str, Layout]] = {
        "positions": Layout(("V", "3"), (torch.float32, torch.float64)),
        "normals": Layout(("V", "3"), (torch.float32, torch.float64)),
        "faces": Layout(("F", "3"), (torch.int32, torch.int64)),
        "albedo": Layout(("V|1", "3|1")),
        "axis": Layout(("L", "3", "V")),
        "coefficients": Layout(("C", "L", "Z", "V")),
        "exact": Layout(("C", "J", "V")),
        "squared_error": Layout(("V",)),
    }

    axis: Tensor
    coefficients: Tensor
    exact: Tensor
    squared_error: Tensor
    albedo: Tensor
    positions: Tensor
    normals: Tensor
    faces: Tensor
    smooth: bool = False
    fit_error: float | None = None

    def __post_init__(self) -> None:
        sizes = check_layouts(self)
        if sizes["C"] not in (1, 3):
            raise InputError(f"transfer has {sizes['C']} channels: it must have 1 or 3")
        lobe_order(sizes["Z"], sizes["J"])

    @property
    def order(self) -> int:
        """Number of SH bands."""
        return lobe_order(self.coefficients.shape[2], self.exact.shape[1])

    @property
    def lobes(self) -> int:
        """Number of lobes L a receiver."""
        return len(self.axis)

    @property
    def channels(self) -> int:
        return len(self.coefficients)

    @property
    def vertices(self) -> int:
        """Number of receivers V."""
        return self.axis.shape[2]

    @property
    def bytes(self) -> int:
        """Bytes of axes and coefficients: what `DiffuseTransfer.bytes` was lowered to."""
        return sum(part.numel() * part.element_size() for part in (self.axis, self.coefficients, self.exact))

    def to_order(self, order: int) -> ZonalTransfer:
        """The first `order` bands. Raises InputError unless 1 (2 with `exact`) <= order <= self.order."""
        kept = fewer_bands(order, self.order, self.exact.shape[1])
        return dataclasses.replace(self, coefficients=self.coefficients[:, :, :kept].contiguous())

    def to(self, dtype: torch.dtype) -> ZonalTransfer:
        """The same with axes and coefficients stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        parts = {name: getattr(self, name).to(dtype) for name in ("axis", "coefficients", "exact")}
        return dataclasses.replace(self, **parts)

    def check(self) -> None:
        """Raises InputError if a tensor holds NaN or infinity, an axis is not of unit length within 1e-4 (or the
        rounding of its dtype), an albedo leaves [0, 1] or a face names no vertex."""
        check_finite(self)
        check_axes("axis", self.axis, 1)
        if self.albedo.numel() and (self.albedo.min() < 0 or self.albedo.max() > 1):
            raise InputError("albedo of the transfer is outside [0, 1]: bake it again")
        if self.faces.numel() and (self.faces.min() < 0 or self.faces.max() >= self.vertices):
            raise InputError("faces of the transfer name vertices that it does not have: bake it again")


def lobe_order(bands: int, exact: int) -> int:
    """The order of lobes of `bands` coefficients beside `exact` coefficients apart; InputError if there is none."""
    if exact not in (0, 4):
        raise InputError(f"exact of the transfer holds {exact} coefficients: it must be 0, or 4 (bands 0 and 1)")
    order = bands + (2 if exact else 0)
    if order == 0:
        raise InputError("coefficients of the transfer have no band: it must have one or more")
    return order


def fewer_bands(order: int, available: int, exact: int) -> int:
    """How many bands of lobes are kept for `order`; InputError if the transfer does not have them."""
    least = 2 if exact else 1
    if not least <= order <= available:
        raise InputError(f"order {order} is not between {least} and the {available} that the transfer has")
    return order - 2 if exact else order


def check_axes(name: str, axis: Tensor, dim: int) -> None:
    """InputError unless all vectors along `dim` are of unit length."""
    off = (torch.linalg.vector_norm(axis.double(), dim=dim) - 1).abs()
    bad = int((off > max(1e-4, 2 * torch.finfo(axis.dtype).eps)).sum())
    if bad:
        raise InputError(f"{name} of the transfer holds {bad} vectors that are not of unit length: fit it again")
