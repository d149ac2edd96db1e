"""A light under a window against ringing that is chosen by its name."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError
from torchprt.sh.constant import remembered

WINDOWS = ("none", "hann", "lanczos", "gauss", "least", "auto")
"""Against ringing."""
NARROWEST = 3
"""What "auto" divides the square of the order by, for the exponent of its lobe."""


def window_factors(light: Float[Tensor, "*B N C"], name: str) -> Float[Tensor, "*B n"]:
    """What one of `WINDOWS`, made for all bands of `light`, multiplies each band by; one window a light.

    - "none": ones.
    - "hann", "lanczos", "gauss": the curves of `sh`, of a width of as many bands as the light has.
    - "least": the weakest Gaussian that leaves the light nowhere negative, `sh.least_window`.
    - "auto": the weakest Gaussian that leaves the light nowhere negative once it is gathered in a lobe cos^(n^2 / 3),
      which is about the narrowest part of the sky that a shadowed receiver of n bands sees. Without any window the
      radiance of diffuse receivers is nearest to what it should be, and least costs most (docs/ringing.md); this
      one is weak, and takes the dark spots away that none leaves. Ones for most lights of a high order.

    Raises InputError for any other name, and with "least" and "auto" as `sh.least_window`.
    """
    if name not in WINDOWS:
        raise InputError(f"window '{name}' is unknown: use one of {', '.join(WINDOWS)}")
    order = sh.order_of(light.shape[-2])
    if name in ("least", "auto"):
        kernel = _narrowest_lobe(light.device, order) if name == "auto" else None
        return sh.least_window(light, kernel)[1]
    if name == "none":
        factors = torch.ones(order, dtype=light.dtype, device=light.device)
    else:
        factors = {"hann": sh.hann, "lanczos": sh.lanczos, "gauss": sh.gauss}[name](order, dtype=light.dtype)
    return factors.to(light.device).expand(*light.shape[:-2], order)


def windowed(light: Float[Tensor, "*B N C"], name: str) -> Float[Tensor, "*B N C"]:
    """`light` with every band multiplied by `window_factors(light, name)`; the light itself if `name` is "none".

    Raises InputError as `window_factors`.
    """
    factors = window_factors(light, name)
    return light if name == "none" else sh.window(light, factors)


@remembered(32)
def _narrowest_lobe(order: int) -> Tensor:
    return sh.phong(order**2 / NARROWEST, order)
