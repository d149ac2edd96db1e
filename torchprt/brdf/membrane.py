"""Light through a thin membrane."""

from __future__ import annotations

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt.errors import InputError


def membrane(translucency: float | int | Float[Tensor, ""], order: int) -> Float64[Tensor, " n"]:
    """A_l of (max(z, 0) + `translucency` max(-z, 0)) / pi: a diffuse sheet lit from both sides.

    What convolution multiplies band l of the light by (as `sh.clamped_cosine`); the transfer vector of an unshadowed
    receiver is `sh.zonal(membrane(a, n), normal)`. For 0.3: 1.3, .466667, .325, 0, -.0541667, 0, .0203125, 0. Odd bands
    above 1 are zero, whatever the sheet. Gradients flow to a tensor.
    Raises InputError if a number `translucency` is outside [0, 1] or `order` is below 1.
    Source: Sloan, Luna and Snyder 2005, equation 23 (which is divided by pi).
    """
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    if not isinstance(translucency, Tensor) and not 0 <= translucency <= 1:
        raise InputError(f"translucency is {translucency:g}: it must be between 0 and 1")
    through = torch.as_tensor(translucency, dtype=torch.float64)
    factors = []
    even = 1.0
    for l in range(order):
        if l == 1:
            factors.append(2 / 3 * (1 - through))
        elif l % 2:
            factors.append(torch.zeros_like(through))
        else:
            factors.append(even * (1 + through))
            even *= 1 / 4 if l == 0 else -(l - 1) / (l + 4)
    return torch.stack(factors)
