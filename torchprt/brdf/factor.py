"""A BRDF as a few products of a function of the view and a function of the light (singular value decomposition)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt import sh
from torchprt.brdf.matrix import exit_kernel, exit_radiance
from torchprt.brdf.models import Brdf
from torchprt.errors import InputError
from torchprt.sh.precision import widened

_DEFAULT_ERROR = 0.05
# The order of the polynomials that view factors are made of is raised until they lose no more than this, relative.
_LOSS = 0.005
_LARGEST_ORDER = 16


@dataclass(frozen=True, eq=False)
class Factors:
    """f(v, s) s_z as `sum_k u_k(v) K_k(s)`, k below `rows`.

    The u_k are orthonormal on the hemisphere and ordered by how much exit radiance they carry.
    - `table [rows, size, size]`: u_k at the texel centres of the map of `hemisphere_map`, float64.
    - `errors`: relative RMS error of exit radiance after 1, 2, 3, ... rows, for all rows there could be (not `rows` of
      them); `errors[rows - 1]` is what this factorisation leaves.
    - `mixture [N, rows]`: u_k in `sh.hemisphere_basis`.
    """

    brdf: Brdf
    mixture: Tensor
    table: Tensor
    errors: tuple[float, ...]

    @property
    def rows(self) -> int:
        """How many products."""
        return self.mixture.shape[1]

    def views(self, view: Float[Tensor, "*D 3"]) -> Float[Tensor, "*D K"]:
        """u_k at unit local directions toward the eye, exactly: what `table` interpolates."""
        return sh.hemisphere_basis(view, sh.order_of(len(self.mixture))) @ self.mixture.to(view)

    def kernel(self, directions: Float[Tensor, "D 3"]) -> Float64[Tensor, "K D"]:
        """K_k(s) = int_H u_k(v) f(v, s) s_z dv at unit local directions to the light: the best given the u_k.

        Not limited to any order on the side of the light. Raises InputError as `exit_kernel`.
        """
        return self.mixture.mT @ exit_kernel(self.brdf, directions, sh.order_of(len(self.mixture)))


def factor(
    brdf: Brdf, *, rows: int | None = None, error: float | None = None, light_order: int = 5, size: int = 32
) -> Factors:
    """The `rows` view factors that lose the least exit radiance, or as few as lose at most `error`, relative RMS.

    The rows of the operator are views, uniform over the hemisphere; its columns the functions of an unshadowed light
    of `light_order`, as in the paper (SH of order 4 there). Its singular value decomposition gives u_k; they are held
    as polynomials, `sh.hemisphere_basis` of order up to 16, raised until that loses less than 0.5 %. Without `rows`
    and `error` the error is 5 %. `size`: of the map of the view.

    Raises InputError if both `rows` and `error` are given, `rows` is not between 1 and `light_order`^2, no number of
    rows reaches `error`, `size` is below 2, or the lobe is too narrow to be integrated.
    Source: Sloan, Luna and Snyder 2005, section 4.2.
    """
    count = light_order * light_order
    if rows is not None and error is not None:
        raise InputError("rows and error are both given: choose one of the two")
    if rows is not None and not 1 <= rows <= count:
        raise InputError(f"rows is {rows}: a light of order {light_order} leaves room for 1 to {count}")
    if size < 2:
        raise InputError(f"size is {size}: a map of the hemisphere has at least 2 texels a side")
    directions, weights, exact = exit_radiance(brdf, _LARGEST_ORDER, light_order)
    power = float((weights[:, None] * exact.square()).sum())
    if not power > 0:
        raise InputError(f"the reflectance '{brdf.spec}' is black: there is nothing to factor")
    values = sh.hemisphere_basis(directions, _LARGEST_ORDER)
    coefficients = values.mT @ (weights[:, None] * exact)
    for order in range(min(light_order, _LARGEST_ORDER), _LARGEST_ORDER + 1):
        kept = coefficients[: order * order]
        if power - float(kept.square().sum()) <= _LOSS**2 * power:
            break
    left, strengths, _ = torch.linalg.svd(kept, full_matrices=False)
    errors = ((power - strengths.square().cumsum(0)).clamp(min=0) / power).sqrt().tolist()
    if rows is None:
        wanted = _DEFAULT_ERROR if error is None else error
        rows = next((k for k, found in enumerate(errors, 1) if found <= wanted), None)
        if rows is None:
            raise InputError(f"error is {wanted:g}: the smallest that can be reached is {errors[-1]:.2g}")
    mixture = left[:, :rows]
    # The sign of a singular function is free: its largest coefficient is made positive.
    mixture = mixture * torch.where(mixture.gather(0, mixture.abs().argmax(0, keepdim=True)) < 0, -1.0, 1.0)
    table = (sh.hemisphere_basis(hemisphere_map(size), order) @ mixture).movedim(-1, 0).contiguous()
    return Factors(brdf, mixture.contiguous(), table, tuple(errors))


def hemisphere_map(size: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, "H W 3"]:
    """Directions of the texel centres of a square map of the hemisphere z > 0 in which all texels are equally large.

    The concentric map from the square to the disc, then Lambert's azimuthal map from the disc to the hemisphere: the
    centre is the normal, the border the horizon; columns go along +x, rows along +y.
    Raises InputError if `size` is below 1.
    Source: Shirley and Chiu 1997, "A low distortion map between disk and square".
    """
    if size < 1:
        raise InputError(f"size is {size}: give at least 1 texel a side")
    ticks = (2 * torch.arange(size, dtype=torch.float64) + 1) / size - 1
    y, x = torch.meshgrid(ticks, ticks, indexing="ij")
    wide = x.abs() >= y.abs()
    radius = torch.where(wide, x, y)
    # In the middle of a map of odd size both are zero.
    quarter = math.pi / 4 * torch.where(wide, y, x) / torch.where(radius == 0, 1.0, radius)
    along, across = radius * quarter.cos(), radius * quarter.sin()
    stretch = (2 - radius * radius).sqrt()
    x, y = torch.where(wide, along, across), torch.where(wide, across, along)
    return torch.stack([stretch * x, stretch * y, 1 - radius * radius], -1).to(dtype)


def sample_hemisphere_map(table: Float[Tensor, "K H H"], view: Float[Tensor, "*D 3"]) -> Float[Tensor, "*D K"]:
    """Values of a `hemisphere_map` at unit directions `view`, bilinear; beyond the outer texel centres it goes on.

    Continuous everywhere. A smooth function is off by the square of a texel, at the kinks of the map, its diagonals, by
    a texel: with 32 texels a side a cosine of amplitude 1 is off by .004 RMS and by .075 at the four corners.
    Plain gathers and products: it exports, and gradients flow to both. Below the horizon the result means nothing but
    stays finite. Read in float32 at least, the result in the dtype of `table`.
    """
    view = widened(view)
    size = table.shape[-1]
    shrink = torch.rsqrt(1 + view[..., 2].clamp(min=0))
    x, y = view[..., 0] * shrink, view[..., 1] * shrink
    wide = x.abs() >= y.abs()
    longer, shorter = torch.where(wide, x, y), torch.where(wide, y, x)
    squared = x * x + y * y
    off = squared > 0
    radius = torch.where(off, torch.where(off, squared, 1.0).sqrt(), 0.0) * torch.sign(longer)
    other = radius * torch.atan(shorter / torch.where(off, longer, 1.0)) * (4 / math.pi)
    column, row = torch.where(wide, radius, other), torch.where(wide, other, radius)
    places = [(part + 1) * (size / 2) - 0.5 for part in (column, row)]
    lows = [place.detach().floor().clamp(0, size - 2) for place in places]
    (right, down) = (place - low for place, low in zip(places, lows, strict=True))
    index = (lows[1] * size + lows[0]).long()
    texels = table.flatten(1)
    top, top_right = texels[:, index], texels[:, index + 1]
    bottom, bottom_right = texels[:, index + size], texels[:, index + size + 1]
    upper = top + right * (top_right - top)
    lower = bottom + right * (bottom_right - bottom)
    return (upper + down * (lower - upper)).movedim(0, -1).to(table.dtype)
