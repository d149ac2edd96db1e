"""Transfer of a texture patch in zonal lobes: a picture that any surface, however it deforms, can be covered with."""

from __future__ import annotations

import dataclasses
import os
from dataclasses import dataclass
from typing import ClassVar

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.file import load_kind, save_kind
from torchprt.transfer.layout import Layout, check_finite, check_layouts
from torchprt.transfer.provenance import Provenance
from torchprt.transfer.zonal import ZonalTransfer, check_axes, fewer_bands, lobe_order


@dataclass(kw_only=True)
class ZonalMap(Provenance):
    """Diffuse transfer of the H x W texels of a patch as sums of `L` zonal lobes, in its tangent frame.

    x runs along u, y along v, z along the normal of whatever the patch is laid on (`shade.lay`). Texel (row, column)
    is centred at v = (row + .5) / H, u = (column + .5) / W. All else is as in `ZonalTransfer`.
    Source: Sloan, Luna and Snyder 2005, sections 4 to 6.

    - `axis [L, 3, H, W]`: unit vectors; `coefficients [C, L, Z, H, W]`; `exact [C, J, H, W]`; `squared_error [H, W]`.
    - `albedo [1 or 3, H or 1, W or 1]`, in [0, 1].
    - `tiles_u`, `tiles_v`: whether the patch repeats itself beyond 0 and 1; else its border goes on.
    - `smooth`: lobes of neighbouring texels correspond, so they are interpolated; else the nearest counts.
    - `fit_error`: RMS over all texels, relative to the transfer.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "zonal map"
    layouts: ClassVar[dict[str, Layout]] = {
        "axis": Layout(("L", "3", "H", "W")),
        "coefficients": Layout(("C", "L", "Z", "H", "W")),
        "exact": Layout(("C", "J", "H", "W")),
        "albedo": Layout(("3|1", "H|1", "W|1")),
        "squared_error": Layout(("H", "W")),
    }

    axis: Tensor
    coefficients: Tensor
    exact: Tensor
    albedo: Tensor
    squared_error: Tensor
    tiles_u: bool = True
    tiles_v: bool = True
    smooth: bool = False
    fit_error: float | None = None

    def __post_init__(self) -> None:
        sizes = check_layouts(self)
        if sizes["C"] not in (1, 3):
            raise InputError(f"transfer has {sizes['C']} channels: it must have 1 or 3")
        if not sizes["H"] or not sizes["W"]:
            raise InputError(f"map of the transfer has {sizes['H']} x {sizes['W']} texels: it must have 1 x 1 or more")
        lobe_order(sizes["Z"], sizes["J"])

    @property
    def order(self) -> int:
        """Number of SH bands."""
        return lobe_order(self.coefficients.shape[2], self.exact.shape[1])

    @property
    def lobes(self) -> int:
        """Number of lobes L a texel."""
        return len(self.axis)

    @property
    def channels(self) -> int:
        return len(self.coefficients)

    @property
    def size(self) -> tuple[int, int]:
        """Rows H and columns W."""
        return self.axis.shape[2], self.axis.shape[3]

    @property
    def bytes(self) -> int:
        """Bytes of axes and coefficients."""
        return sum(part.numel() * part.element_size() for part in (self.axis, self.coefficients, self.exact))

    def to_order(self, order: int) -> ZonalMap:
        """The first `order` bands. Raises InputError unless 1 (2 with `exact`) <= order <= self.order."""
        kept = fewer_bands(order, self.order, self.exact.shape[1])
        return dataclasses.replace(self, coefficients=self.coefficients[:, :, :kept].contiguous())

    def to(self, dtype: torch.dtype) -> ZonalMap:
        """The same with axes and coefficients stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        parts = {name: getattr(self, name).to(dtype) for name in ("axis", "coefficients", "exact")}
        return dataclasses.replace(self, **parts)

    def check(self) -> None:
        """Raises InputError if a tensor holds NaN or infinity, an axis is not of unit length within 1e-4 (or the
        rounding of its dtype) or an albedo leaves [0, 1]."""
        check_finite(self)
        check_axes("axis", self.axis, 1)
        if self.albedo.min() < 0 or self.albedo.max() > 1:
            raise InputError("albedo of the map is outside [0, 1]: bake it again")


def zonal_map(
    texels: ZonalTransfer, rows: int, columns: int, *, tiles_u: bool = True, tiles_v: bool = True
) -> ZonalMap:
    """A map from the lobes of its texels, row after row.

    Raises InputError if there are not `rows` * `columns` receivers.
    """
    if texels.vertices != rows * columns:
        raise InputError(f"lobes are of {texels.vertices} receivers: a map of {rows} x {columns} has other texels")
    shape = (rows, columns)
    albedo = texels.albedo.mT.unflatten(1, shape) if len(texels.albedo) > 1 else texels.albedo[0, :, None, None]
    metadata = {field.name: getattr(texels, field.name) for field in dataclasses.fields(Provenance)}
    return ZonalMap(
        axis=texels.axis.unflatten(-1, shape),
        coefficients=texels.coefficients.unflatten(-1, shape),
        exact=texels.exact.unflatten(-1, shape),
        albedo=albedo.contiguous(),
        squared_error=texels.squared_error.unflatten(-1, shape),
        tiles_u=tiles_u,
        tiles_v=tiles_v,
        smooth=texels.smooth,
        fit_error=texels.fit_error,
        **metadata,
    )


def save_map(patch: ZonalMap, path: str | os.PathLike[str]) -> None:
    """Writes a map to `path` (`.safetensors`), in the format of `save` and as safely."""
    save_kind(patch, path)


def load_map(path: str | os.PathLike[str]) -> ZonalMap:
    """Reads a map that `save_map` wrote. Raises InputError as `load`, and if the file holds transfer of receivers."""
    patch = load_kind(path, {ZonalMap.kind: ZonalMap})
    assert isinstance(patch, ZonalMap)
    return patch


def holds_map(path: str | os.PathLike[str]) -> bool:
    """Whether a file says that it holds a map; not whether it is sound."""
    try:
        with safe_open(path, framework="pt") as file:
            return (file.metadata() or {}).get("kind") == ZonalMap.kind
    except (SafetensorError, OSError):
        return False
