"""Rays of receivers as arrays of rays."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor


def starts(origins: Float[Tensor, "v *S 3"], rays: int) -> Float[Tensor, "v {rays} 3"]:
    """Where each ray of a receiver starts: all at its one origin, or every S-th at the same of S."""
    if origins.ndim == 2:
        return origins[:, None].expand(-1, rays, -1)
    return origins[:, torch.arange(rays) % origins.shape[1]]


def in_the_world(
    origins: Float[Tensor, "v *S 3"], frames: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
) -> tuple[Float32[np.ndarray, "E 3"], Float32[np.ndarray, "E 3"]]:
    """`[v * D, 3]` origins and directions, the rays of one point together (better for the caches of Embree)."""
    start = starts(origins, len(directions)).reshape(-1, 3)
    # Components first: three products that stream; embreex reads any strides.
    world = torch.mm(frames.transpose(1, 2).transpose(0, 1).reshape(-1, 3), directions.T).view(3, -1)
    return start.numpy(), world.numpy().T
