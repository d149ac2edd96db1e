"""An environment as it is looked at: its light, and the picture behind the model."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError

GREY = 0.35
"""The mean radiance of an environment, as `automatic_exposure` shows it: a facing surface of albedo 1 is near white."""
ROWS = 64
"""Rows of the picture of a light that has no image."""


@dataclass(frozen=True)
class Environment:
    """A light `[N, 3]`, of the highest order that is wanted of it, and the latitude-longitude map it is of, if any."""

    name: str
    light: Float[Tensor, "N 3"]
    image: Float[Tensor, "H W 3"] | None = None


def automatic_exposure(light: Float[Tensor, "N 3"]) -> float:
    """Stops that show the mean radiance of `light` as a middling grey; 0 for a light whose mean is black."""
    mean = float(light[0].mean()) * 0.5 / math.sqrt(math.pi)
    return math.log2(GREY / mean) if mean > 0 else 0.0


def photograph(light: Float[Tensor, "N 3"], rows: int = ROWS) -> Float[Tensor, "H W 3"]:
    """The latitude-longitude map of radiance that a light stands for, black where it rings below 0."""
    directions = sh.latlong_directions(rows, 2 * rows, dtype=light.dtype)
    return (sh.basis(directions, math.isqrt(len(light))) @ light).clamp(min=0)


def seen_along(
    image: Float[Tensor, "H W 3"], directions: Float[Tensor, "*S 3"], rotation: Float[Tensor, "3 3"] | None = None
) -> Float[Tensor, "*S 3"]:
    """Radiance of a latitude-longitude map, turned by `rotation`, along world directions of any length; bilinear.

    Raises InputError unless the image is twice as wide as high.
    """
    height, width, _ = image.shape
    if width != 2 * height or height == 0:
        raise InputError(f"an environment of {width} x {height} pixels is no latitude-longitude map: crop or resize it")
    if rotation is not None:
        # The turned environment f(R^T s): rows times R are R^T s.
        directions = directions @ rotation.to(directions)
    x, y, z = directions.to(image.dtype).unbind(-1)
    column = torch.atan2(x, -z) / math.pi
    row = 2 * torch.atan2(torch.hypot(x, z), y) / math.pi - 1
    # Longitude closes: a texel more on either side.
    closed = torch.cat([image[:, -1:], image, image[:, :1]], 1).movedim(-1, 0)[None]
    grid = torch.stack([column * width / (width + 2), row], -1).reshape(1, 1, -1, 2)
    found = F.grid_sample(closed, grid, mode="bilinear", padding_mode="border", align_corners=False)
    return found[0, :, 0].T.reshape(*directions.shape[:-1], 3)
