"""A pinhole camera and where to put it so that a model is seen whole."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError


@dataclass(frozen=True)
class Camera:
    """Looks from `eye` at `target`; `field` is the full vertical angle of view in degrees. All in world units, y up."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    field: float = 35.0

    def directions(self, width: int, height: int) -> Float[Tensor, "H W 3"]:
        """The world direction through the middle of every pixel, float64, not of unit length.

        Raises InputError if the picture has no pixels or the camera looks along its own `up`.
        """
        if width < 1 or height < 1:
            raise InputError(f"size {width}x{height} has no pixels: give width and height from 1")
        eye, target, up = (torch.tensor(v, dtype=torch.float64) for v in (self.eye, self.target, self.up))
        forward = torch.nn.functional.normalize(target - eye, dim=0)
        right = torch.linalg.cross(forward, up)
        if not float(right.norm()) > 1e-6 * float(up.norm()):
            raise InputError("the camera looks along its up vector: move the eye or give another up")
        right = torch.nn.functional.normalize(right, dim=0)
        above = torch.linalg.cross(right, forward)
        reach = math.tan(math.radians(self.field) / 2)
        x = (2 * (torch.arange(width, dtype=torch.float64) + 0.5) / width - 1) * reach * width / height
        y = (1 - 2 * (torch.arange(height, dtype=torch.float64) + 0.5) / height) * reach
        return forward + x[None, :, None] * right + y[:, None, None] * above


def frame(
    positions: Float[Tensor, "V 3"],
    toward: tuple[float, float, float] = (0.45, 0.35, 1.0),
    *,
    aspect: float = 4 / 3,
    field: float = 35.0,
) -> Camera:
    """The camera in direction `toward` (from the model) that holds the model whole. Raises InputError without points."""
    if len(positions) == 0:
        raise InputError("there is nothing to look at: the model has no vertices")
    points = positions.to(torch.float64)
    middle = (points.amin(0) + points.amax(0)) / 2
    radius = max(float((points - middle).norm(dim=-1).max()), 1e-30)
    narrow = math.atan(math.tan(math.radians(field) / 2) * min(1.0, aspect))
    direction = torch.nn.functional.normalize(torch.tensor(toward, dtype=torch.float64), dim=0)
    eye = middle + direction * (0.92 * radius / math.sin(narrow))
    x, y, z = eye.tolist()
    u, v, w = middle.tolist()
    return Camera((x, y, z), (u, v, w), field=field)
