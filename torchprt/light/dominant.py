"""One lamp in place of a light: what a renderer without transfer would use."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.light.analytic import directional

# Rec. 709.
_LUMINANCE = (0.2126, 0.7152, 0.0722)


def dominant(light: Float[Tensor, "*B N 3"]) -> tuple[Float[Tensor, "*B 3"], Float[Tensor, "*B 3"]]:
    """The direction from which most of a light comes, and the radiance of the lamp there that stands best for it.

    `directional(direction, radiance, order=n)` is nearest to the light among the lamps of that direction whose radiance
    is not negative; the direction is the vector of band 1 of its luminance, +y if it has none.
    Raises InputError if N is not a square number.
    Source: Sloan, "Stupid spherical harmonics (SH) tricks" (2008), optimal linear direction and directional light.
    """
    order = sh.order_of(light.shape[-2])
    if order == 1:
        vector = light.new_zeros(*light.shape[:-2], 3)
    else:
        luminance = light @ torch.tensor(_LUMINANCE, dtype=light.dtype, device=light.device)
        vector = torch.stack([-luminance[..., 3], -luminance[..., 1], luminance[..., 2]], -1)
    up = torch.tensor([0.0, 1.0, 0.0], dtype=light.dtype, device=light.device)
    # Squares of very dim and very bright lights leave the range of floats.
    largest = vector.detach().abs().amax(-1, keepdim=True)
    scaled = torch.where(largest > 0, vector / torch.where(largest > 0, largest, 1.0), up)
    direction = scaled / torch.linalg.vector_norm(scaled, dim=-1, keepdim=True)
    lamp = directional(direction, order=order)
    radiance = (lamp * light).sum(-2) / (lamp * lamp).sum(-2)
    return direction, radiance.clamp(min=0)
