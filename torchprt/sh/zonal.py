"""Circularly symmetric functions and convolution with them.

Everywhere in this file the coefficient of band l is A_l = 2 pi int_-1^1 h(z) P_l(z) dz: what convolution
multiplies band l by. The ordinary zonal coefficient of y_l0 is sqrt((2l + 1) / 4 pi) A_l.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import bands, basis, order_of


def clamped_cosine(order: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, " n"]:
    """A_l of max(z, 0): pi, 2 pi / 3, pi / 4, 0, -pi / 24, ...; irradiance is `convolve(light, clamped_cosine(n))`.

    Source: Ramamoorthi and Hanrahan 2001, "An efficient representation for irradiance environment maps", eq. 8.
    """
    _check_order(order)
    factors = [math.pi, 2 * math.pi / 3][:order]
    even = math.pi / 4
    for l in range(2, order):
        factors.append(0.0 if l % 2 else even)
        if l % 2 == 0:
            even *= -(l - 1) / (l + 4)
    return torch.tensor(factors, dtype=dtype)


def _check_order(order: int) -> None:
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
