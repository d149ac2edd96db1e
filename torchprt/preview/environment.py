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
from torchprt.light import built_in, project, windowed
from torchprt.shade.white import white

PANORAMA = 256
"""Rows of a built-in light."""
ROWS = 64
"""Rows of the picture of a light that has no image."""


@dataclass(frozen=True)
class Environment:
    """A light `[N, 3]`, of the highest order that is wanted of it, and the latitude-longitude map it is of, if any."""

    name: str
    light: Float[Tensor, "N 3"]
    image: Float[Tensor, "H W 3"] | None = None


def built_in_environment(name: str, order: int, window: str = "least") -> Environment:
    """One of `light.BUILT_IN` at `order`, under the least window that keeps it positive, or another of `light.WINDOWS`.

    Raises InputError for an unknown name or window.
    """
    image = built_in(name, PANORAMA)
    return Environment(name, windowed(project(image, order), window), image)


def automatic_exposure(light: Float[Tensor, "N 3"]) -> float:
    """Stops at which a white surface that faces most of `light` is just white; 0 for a light that is black.

    That is what a meter of incident light says, so that a dark model stays dark, and no picture of a turntable differs
    from the next. Measured is the largest irradiance / pi of a surface that nothing shadows, in luminance.
    """
    most = float(white(light.double()))
    return -math.log2(most) if most > 0 else 0.0


def for_pixels(image: Float[Tensor, "H W 3"], pixel: float) -> Float[Tensor, "h w 3"]:
    """A latitude-longitude map to be read once for each pixel of `pixel` radians by `seen_along`.

    One that is finer is averaged, so that nothing glitters; one that is much coarser is smoothed over its neighbours,
    so that no texels are seen.
    """
    rows = max(1, math.ceil(math.pi / pixel))
    planes = image.movedim(-1, 0)[None]
    if rows < image.shape[0]:
        return F.interpolate(planes, (rows, 2 * rows), mode="area")[0].movedim(0, -1)
    if rows < 2 * image.shape[0]:
        return image
    kernel = image.new_tensor([1.0, 4.0, 6.0, 4.0, 1.0]) / 16
    wide = F.pad(planes, (2, 2, 0, 0), mode="circular")
    tall = F.pad(F.conv2d(wide.movedim(0, 1), kernel.view(1, 1, 1, 5)), (0, 0, 2, 2), mode="replicate")
    return F.conv2d(tall, kernel.view(1, 1, 5, 1))[:, 0].movedim(0, -1)


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
