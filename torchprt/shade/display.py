"""From linear radiance to what a screen shows. The one place with a tone map and sRGB."""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

ToneMap = Literal["none", "filmic"]


def filmic(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S 3"]:
    """Filmic tone curve from [0, inf) to [0, 1]: soft toe and shoulder, mid grey .18 maps near .27 before sRGB.

    Negative radiance (ringing of a truncated light) maps to 0.
    Source: Narkowicz 2015, a fit of the ACES reference transform.
    """
    x = torch.clamp(radiance, min=0)
    # Divided through by x^2 above 1, so that 1e30 does not overflow float32.
    small = torch.clamp(x, max=1)
    large = 1 / torch.clamp(x, min=1)
    below = small * (2.51 * small + 0.03) / (small * (2.43 * small + 0.59) + 0.14)
    above = (2.51 + 0.03 * large) / (2.43 + large * (0.59 + 0.14 * large))
    return torch.clamp(torch.where(x > 1, above, below), max=1)


def srgb(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S 3"]:
    """Linear RGB to sRGB (IEC 61966-2-1). Values outside [0, 1] are clipped to what a screen can show."""
    from kornia.color import linear_rgb_to_rgb

    planes = torch.clamp(radiance, 0, 1).movedim(-1, 0).reshape(1, 3, -1, 1)
    return linear_rgb_to_rgb(planes).reshape(3, *radiance.shape[:-1]).movedim(0, -1)


def display(
    radiance: Float[Tensor, "*S 3"], *, exposure: float | Tensor = 0.0, tone: ToneMap = "filmic"
) -> Float[Tensor, "*S 3"]:
    """sRGB picture values in [0, 1] from linear radiance: exposure (in stops), tone map, sRGB, in this order.

    Raises InputError for an unknown tone map.
    """
    if tone not in ("none", "filmic"):
        raise InputError(f"tone map '{tone}' is unknown: use 'none' or 'filmic'")
    stops = torch.as_tensor(exposure, dtype=radiance.dtype, device=radiance.device)
    exposed = radiance * torch.exp2(stops)
    return srgb(filmic(exposed) if tone == "filmic" else exposed)
