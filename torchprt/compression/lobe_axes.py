"""The error of zonal lobes as a function of their axes alone, with its slope and curvature, for many vectors at once.

Given axes `s_i`, the best coefficients of band l solve a small system, because of the addition theorem
`y_l(s_i) . y_l(s_j) = (2l + 1) / 4 pi P_l(s_i . s_j)`: with `u_l = sqrt(4 pi / (2l + 1)) y_l`, of unit length,
`sum_j P_l(s_i . s_j) h_j = u_l(s_i) . t`. What is left to seek are the axes: variable projection (Golub and Pereyra
1973). The **heights** h are `sqrt((2l + 1) / 4 pi)` times the coefficients g* of Sloan, Luna and Snyder 2005.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from torchprt.compression.small_systems import backward, cholesky, forward
from torchprt.sh import basis, gauss_legendre
from torchprt.sh.constant import remembered

# Of the unit diagonal of a system: keeps lobes that come to coincide from growing heights of opposite sign.
RIDGE = 1e-5


@dataclass(frozen=True)
class Target:
    """What lobes are to be: `vectors [N, C, V]`, of which bands `first` and above are looked at.

    The least of `|t - sum_i h_i u(s_i)|^2 + ridge |h - heights|^2 + pull |s - axes|^2` is sought, with `heights
    [L, C, B, V]` (B bands; zero if None) and `axes [L, 3, V]` (no pull if None).
    """

    vectors: Tensor
    first: int
    ridge: float = RIDGE
    heights: Tensor | None = None
    axes: Tensor | None = None
    pull: float = 0.0

    @property
    def order(self) -> int:
        return math.isqrt(len(self.vectors))

    def __len__(self) -> int:
        return self.vectors.shape[-1]

    def __getitem__(self, points: slice | Tensor) -> Target:
        heights, axes = (part if part is None else part[..., points] for part in (self.heights, self.axes))
        return Target(self.vectors[..., points], self.first, self.ridge, heights, axes, self.pull)


@dataclass
class Fit:
    """Lobes of one set of axes, and how what is sought changes with the axes.

    `axes [L, 3, V]`, `tangents [2, 3, L, V]` across them, `heights [L, C, B, V]`; `error [V]`: what is sought, less the
    power of the vectors; `slope [2 L, V]`: minus half its gradient along the tangents; `curvature [2 L, 2 L, V]`: half
    its second derivatives, less the terms that vanish with the residual (Gauss-Newton, Kaufman 1975).
    """

    axes: Tensor
    tangents: Tensor
    heights: Tensor
    error: Tensor
    slope: Tensor
    curvature: Tensor

    def __getitem__(self, points: Tensor) -> Fit:
        return Fit(**{name: part[..., points] for name, part in vars(self).items()})

    def where(self, chosen: Tensor, other: Fit) -> Fit:
        """This fit at the points that are `chosen`, the `other` elsewhere."""
        return Fit(**{name: torch.where(chosen, part, getattr(other, name)) for name, part in vars(self).items()})


def fit_heights(target: Target, axes: Tensor) -> tuple[Tensor, Tensor]:
    """The best heights `[L, C, B, V]` at `axes [L, 3, V]`, and what is sought `[V]`, less the power of the vectors."""
    value = _values(target, axes)
    factor = _factor(target, legendre(_cosines(axes), target.order)[0])
    heights, error = _solve(target, factor, value)
    return heights, error + _pulled(target, axes)


def evaluate(target: Target, slopes: list[Tensor], axes: Tensor) -> Fit:
    """`Fit` at `axes [L, 3, V]`; `slopes` are those of the vectors of the target."""
    lobes, _, points = axes.shape
    value, gradient = _values_and_gradients(target, slopes, axes)
    p, rise, bend = legendre(_cosines(axes), target.order)
    rise, bend = rise[target.first :].movedim(0, 2), bend[target.first :].movedim(0, 2)
    factor = _factor(target, p)
    heights, error = _solve(target, factor, value)
    tangents = tangents_of(axes)

    # e_i . s_j for both tangents e_i, and the change of P(s_i . s_j) as s_i moves along e_i: [2, L, L, (B,) V].
    along = (tangents[:, :, :, None] * axes.movedim(1, 0)[:, None]).sum(1)
    change = rise * along[:, :, :, None]
    residual = (tangents[:, :, :, None, None] * gradient).sum(1) - (change[:, :, :, None] * heights).sum(2)
    slope = (residual * heights).sum((2, 3))

    # Derivatives of the lobes, less what heights can follow; both are products over lobes, summed over bands.
    products = (heights[:, None] * heights).sum(2)
    once, twice = (products * rise).sum(2), (products * bend).sum(2)
    across = (tangents[:, None, :, :, None] * tangents[:, :, None]).sum(2)
    curvature = torch.addcmul(twice * along[:, None] * along.transpose(1, 2), once, across)
    curvature = curvature.transpose(1, 2).reshape(2 * lobes, 2 * lobes, points)
    followed = forward(factor, change.permute(2, 0, 1, 3, 4))[:, :, :, None] * heights
    followed = followed.permute(1, 2, 0, 3, 4, 5).flatten(2, 4).flatten(0, 1)
    for row, one in enumerate(followed):
        curvature[row, : row + 1] -= (one * followed[: row + 1]).sum(1)
        curvature[:row, row] = curvature[row, :row]

    if target.axes is not None:
        error = error + _pulled(target, axes)
        slope = slope + target.pull * (tangents * (target.axes - axes).movedim(1, 0)).sum(1)
        curvature.diagonal().add_(target.pull)
    return Fit(axes, tangents, heights, error, slope.reshape(2 * lobes, points), curvature)


def sum_of_lobes(axes: Tensor, heights: Tensor, order: int, first: int) -> Tensor:
    """SH coefficients `[N, C, V]` of lobes of `axes [L, 3, V]` and `heights [L, C, B, V]`, zero below band `first`."""
    table = basis(axes.movedim(1, -1), order).movedim(-1, 0)
    result = axes.new_zeros(order * order, heights.shape[1], axes.shape[2])
    for place, l in enumerate(range(first, order)):
        rows = slice(l * l, (l + 1) ** 2)
        scale = math.sqrt(4 * math.pi / (2 * l + 1))
        torch.sum(table[rows, None] * (scale * heights[:, :, place].movedim(0, 1)), 2, out=result[rows])
    return result


def slopes_of(target: Target) -> list[Tensor]:
    """What multiplies y_l: the coefficients of band l, and those of the gradient of band l + 1; `[4, 2l + 1, C, V]`.

    Derivatives in x, y and z of a harmonic polynomial of degree l + 1 are such of degree l. In units of `u_l`.
    """
    vectors, order = target.vectors, target.order
    result = []
    for l in range(target.first - 1, order):
        both = vectors.new_zeros(4, 2 * l + 1, *vectors.shape[1:])
        both[0] = vectors[l * l : (l + 1) ** 2] * math.sqrt(4 * math.pi / (2 * l + 1))
        if l + 1 < order:
            above = vectors[(l + 1) ** 2 : (l + 2) ** 2] * math.sqrt(4 * math.pi / (2 * l + 3))
            derived = _derivatives(vectors.device, l + 1).to(vectors) @ above.flatten(1)
            both[1:] = derived.reshape(3, *both.shape[1:])
        result.append(both)
    return result


@remembered(64)
def _derivatives(band: int) -> Tensor:
    """`[3, 2l - 1, 2l + 1]`: the coefficients in band l - 1 of the derivatives of `r^l y_lm`.

    `x r^l y_lm` is harmonic but for `r^2 / (2l + 1)` times its derivative in x, which is so 2l + 1 times the part of
    `x y_lm` in band l - 1.
    """
    directions, weights = gauss_legendre(2 * band)
    table = basis(directions, band + 1)
    lower, upper = table[:, (band - 1) ** 2 : band**2], table[:, band**2 :]
    return (2 * band + 1) * torch.einsum("d,dk,da,db->kab", weights, directions, lower, upper)


def _values(target: Target, axes: Tensor) -> Tensor:
    """`u_l(s) . t`, `[L, C, B, V]`."""
    order, first = target.order, target.first
    table = basis(axes.movedim(1, -1), order).movedim(-1, 0)
    parts = []
    for l in range(first, order):
        rows = slice(l * l, (l + 1) ** 2)
        part = (table[rows, None] * target.vectors[rows, :, None]).sum(0)
        parts.append(part * math.sqrt(4 * math.pi / (2 * l + 1)))
    return torch.stack(parts, 1).movedim(2, 0)


def _values_and_gradients(target: Target, slopes: list[Tensor], axes: Tensor) -> tuple[Tensor, Tensor]:
    """`u_l(s) . t`, `[L, C, B, V]`, and its derivatives in x, y and z, `[3, L, C, B, V]`."""
    table = basis(axes.movedim(1, -1), target.order).movedim(-1, 0)
    parts = []
    for l, both in enumerate(slopes, target.first - 1):
        parts.append((table[l * l : (l + 1) ** 2, None] * both[:, :, :, None]).sum(1))
    value = torch.stack([part[0] for part in parts[1:]], 2)
    gradient = torch.stack([part[1:] for part in parts[:-1]], 3)
    return value.movedim(1, 0), gradient.movedim(2, 1)


def _cosines(axes: Tensor) -> Tensor:
    return (axes[:, None] * axes).sum(2)


def _factor(target: Target, p: Tensor) -> Tensor:
    ridge = target.ridge * torch.eye(p.shape[1], dtype=p.dtype, device=p.device)
    return cholesky(p[target.first :].movedim(0, 2) + ridge[:, :, None, None])


def _solve(target: Target, factor: Tensor, value: Tensor) -> tuple[Tensor, Tensor]:
    if target.heights is None:
        half = forward(factor, value)
        return backward(factor, half), -half.square().sum((0, 1, 2))
    half = forward(factor, value + target.ridge * target.heights)
    error = target.ridge * target.heights.square().sum((0, 1, 2)) - half.square().sum((0, 1, 2))
    return backward(factor, half), error


def _pulled(target: Target, axes: Tensor) -> Tensor | float:
    return 0.0 if target.axes is None else target.pull * (axes - target.axes).square().sum((0, 1))


def legendre(z: Tensor, order: int) -> tuple[Tensor, Tensor, Tensor]:
    """P_l, P_l' and P_l'' at `z [*S]`, `[order, *S]` each."""
    p, rise, bend = (z.new_zeros(max(order, 2), *z.shape) for _ in range(3))
    p[0], p[1], rise[1] = 1, z, 1
    for l in range(2, order):
        p[l] = ((2 * l - 1) * z * p[l - 1] - (l - 1) * p[l - 2]) / l
        rise[l] = rise[l - 2] + (2 * l - 1) * p[l - 1]
        bend[l] = bend[l - 2] + (2 * l - 1) * rise[l - 1]
    return p[:order], rise[:order], bend[:order]


def tangents_of(axes: Tensor) -> Tensor:
    """Two orthonormal directions `[2, 3, L, V]` across each of `axes [L, 3, V]` (Duff et al. 2017)."""
    x, y, z = axes.unbind(1)
    sign = torch.where(z < 0, -1.0, 1.0).to(z)
    a = -1 / (sign + z)
    b = x * y * a
    return torch.stack([1 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y]).unflatten(0, (2, 3))
