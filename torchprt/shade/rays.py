"""Rays of a pinhole camera, for many eyes at once."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

# Horizontal part of a direction, relative to its length, below which it counts as straight up or down.
STEEP = 1e-4


def pinhole(
    eye: Float[Tensor, "*#B 3"], target: Float[Tensor, "*#B 3"], size: tuple[int, int], field: float = 35.0
) -> Float[Tensor, "... H W 3"]:
    """The world direction through the middle of every pixel of a picture `size` (width, height), not of unit length.

    The camera looks from `eye` at `target`; +y is up in the picture, or -z if it looks straight up or down. `field`:
    the vertical angle of view in degrees. Gradients flow to both. An eye at the target looks along -z.
    """
    width, height = size
    forward = target - eye
    length = torch.linalg.vector_norm(forward, dim=-1, keepdim=True)
    ahead = forward.new_tensor([0.0, 0.0, -1.0])
    forward = torch.where(length > 0, forward / torch.where(length > 0, length, 1.0), ahead)
    x, y, z = forward.unbind(-1)
    steep = x * x + z * z <= STEEP**2
    nothing = torch.zeros_like(x)
    # The cross products of forward with +y and with -z.
    right = torch.where(steep.unsqueeze(-1), torch.stack([-y, x, nothing], -1), torch.stack([-z, nothing, x], -1))
    right = right / torch.linalg.vector_norm(right, dim=-1, keepdim=True)
    above = torch.linalg.cross(right, forward, dim=-1)
    reach = math.tan(math.radians(field) / 2)
    across = (2 * (torch.arange(width, device=x.device) + 0.5) / width - 1).to(x.dtype) * (reach * width / height)
    up = (1 - 2 * (torch.arange(height, device=x.device) + 0.5) / height).to(x.dtype) * reach
    forward, right, above = (axis[..., None, None, :] for axis in (forward, right, above))
    return forward + across[None, :, None] * right + up[:, None, None] * above
