"""Circularly symmetric functions and convolution with them.

Everywhere in this file the coefficient of band l is A_l = 2 pi int_-1^1 h(z) P_l(z) dz: what convolution
multiplies band l by. The ordinary zonal coefficient of y_l0 is sqrt((2l + 1) / 4 pi) A_l.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import band_of, basis, order_of


def clamped_cosine(order: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, " n"]:
    """A_l of max(z, 0): pi, 2 pi / 3, pi / 4, 0, -pi / 24, ...

    Irradiance is `convolve(light, clamped_cosine(n))`.

    Raises InputError if `order` is below 1.
    Source: Ramamoorthi and Hanrahan 2001, "An efficient representation for irradiance environment maps", eq.
    8.
    """
    _check_order(order)
    factors = [math.pi, 2 * math.pi / 3][:order]
    even = math.pi / 4
    for l in range(2, order):
        factors.append(0.0 if l % 2 else even)
        if l % 2 == 0:
            even *= -(l - 1) / (l + 4)
    return torch.tensor(factors, dtype=dtype)


def phong(
    exponent: float | int | Float[Tensor, "*B"], order: int, dtype: torch.dtype | None = None
) -> Float[Tensor, "*B n"]:
    """A_l of the normalised lobe (k + 1) / 2 pi max(z, 0)^k for an `exponent` k from 0 (half sphere) upward.

    A product, without cancellation at any k: A_0 = 1, and all A_l tend to 1 (a mirror) as k grows. Gradients
    flow to a tensor `exponent`. `dtype` is that of the tensor, or float64 for a number.
    Raises InputError if `order` is below 1 or a number `exponent` is negative (a tensor is not checked).
    Source: A_(l+2) = A_l (k - l) / (k + l + 3), by parts from the recurrence of the Legendre polynomials;
    the lobe of Sloan, Kautz and Snyder 2002, section 6.
    """
    _check_order(order)
    if not isinstance(exponent, Tensor):
        if not exponent >= 0:
            raise InputError(f"exponent of a Phong lobe must be zero or more, not {exponent}")
        exponent = torch.tensor(float(exponent), dtype=dtype or torch.float64)
    k = exponent.to(dtype or exponent.dtype)
    factors = [torch.ones_like(k), (k + 1) / (k + 2)][:order]
    for l in range(order - 2):
        factors.append(factors[l] * ((k - l) / (k + l + 3)))
    return torch.stack(factors, -1)


def disc(
    half_angle: float | int | Float[Tensor, "*B"], order: int, dtype: torch.dtype | None = None
) -> Float[Tensor, "*B n"]:
    """A_l of the indicator of a spherical cap of `half_angle` radians, from 0 to pi.

    Keeps its relative accuracy for tiny caps: the cancelling P_(l-1) - P_(l+1) is replaced by
    sin^2 P_l' (2l + 1) / (l (l + 1)), and P_l' has its own recurrence. Gradients flow to a tensor
    `half_angle`. `dtype` is that of the tensor, or float64 for a number.
    Raises InputError if `order` is below 1 or a number `half_angle` is outside [0, pi] (a tensor is not
    checked).
    Source: A_l = 2 pi (P_(l-1)(c) - P_(l+1)(c)) / (2l + 1), c the cosine of the half angle.
    """
    _check_order(order)
    if not isinstance(half_angle, Tensor):
        if not 0 <= half_angle <= math.pi:
            raise InputError(f"half_angle must lie between 0 and pi radians, not {half_angle}")
        half_angle = torch.tensor(float(half_angle), dtype=dtype or torch.float64)
    angle = half_angle.to(dtype or half_angle.dtype)
    c, area = torch.cos(angle), torch.sin(angle).square()
    slopes = [torch.ones_like(c), 3 * c]
    for n in range(2, order):
        slopes.append(((2 * n + 1) * c * slopes[n - 1] - (n + 1) * slopes[n - 2]) / n)
    factors = [4 * math.pi * torch.sin(angle / 2).square()]
    factors += [2 * math.pi / (l * (l + 1)) * area * slopes[l - 1] for l in range(1, order)]
    return torch.stack(factors, -1)


def convolve(light: Float[Tensor, "*#B N C"], kernel: Float[Tensor, "*#B n"]) -> Float[Tensor, "... N C"]:
    """`light` convolved with the circularly symmetric function of band coefficients A_l `kernel`.

    Leading dimensions broadcast; the result has dtype and device of `light`.
    Raises InputError if N is not a square number or `kernel` does not have one coefficient a band.
    Source: Sloan, Kautz and Snyder 2002, section 3, equation 6 (Funk-Hecke).
    """
    order = order_of(light.shape[-2])
    if kernel.shape[-1] != order:
        raise InputError(f"kernel has {kernel.shape[-1]} bands but the light has order {order}: give one a band")
    return light * kernel.to(light)[..., band_of(light.device, order)].unsqueeze(-1)


def zonal(coefficients: Float[Tensor, "*#B n"], axis: Float[Tensor, "*#B 3"]) -> Float[Tensor, "... N"]:
    """SH coefficients of the circularly symmetric function h(axis . s) whose band coefficients A_l are given.

    `axis` has unit length (not checked); leading dimensions broadcast; gradients flow to both. The function
    of a distant lamp is `zonal(disc(angle, n), axis)`, of a clamped cosine about a normal
    `zonal(clamped_cosine(n), normal)`. The result has dtype and device of `axis`.
    Source: Sloan, Luna and Snyder 2005, section 3: f_lm = A_l y_lm(axis).
    """
    order = coefficients.shape[-1]
    return basis(axis, order) * coefficients.to(axis)[..., band_of(axis.device, order)]


def _check_order(order: int) -> None:
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
