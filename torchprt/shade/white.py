"""What counts as white under a light."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import basis, clamped_cosine, convolve, latlong_directions, order_of
from torchprt.sh.constant import remembered

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear Rec. 709."""
# Rows of the directions among which the brightest is looked for.
_METER = 24
# Irradiance has next to nothing above.
_ORDER = 5


def white(light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B"]:
    """The radiance of a white diffuse surface that faces most of the light and that nothing shadows, in luminance.

    What a meter of incident light says: pictures are exposed so that it is just white. As large as the light, and the
    same however that is turned but for the directions that are tried. Zero for a light that is black.
    """
    order = min(order_of(light.shape[-2]), _ORDER)
    radiance = light[..., : order**2, :] @ light.new_tensor(LUMINANCE)
    facing = _facing(light.device, order, light.dtype)
    return (radiance @ facing).amax(-1).clamp(min=0)


@remembered(8)
def _facing(order: int, dtype: torch.dtype) -> Tensor:
    """From radiance `[N]` to irradiance / pi along directions, `[N, D]`."""
    cosine = clamped_cosine(order, dtype=torch.float64)
    table = basis(latlong_directions(_METER, 2 * _METER).double().reshape(-1, 3), order) / math.pi
    return convolve(table.mT, cosine).to(dtype).contiguous()
