"""A pinhole camera and where to put it so that a model is seen whole."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

STEEP = 1e-4
"""Horizontal part of a direction below which it counts as straight up or down."""
MARGIN = 0.94
"""Share of the half picture that a framed model may fill."""


@dataclass(frozen=True)
class Camera:
    """Looks from `eye` at `target`; `field` is the full vertical angle of view in degrees. All in world units, y up."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    field: float = 35.0

    def axes(self) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"], Float[Tensor, "3"]]:
        """Unit vectors forward, right and above of the picture, float64.

        Raises InputError if the camera looks along its own `up`.
        """
        eye, target, up = (torch.tensor(v, dtype=torch.float64) for v in (self.eye, self.target, self.up))
        forward = torch.nn.functional.normalize(target - eye, dim=0)
        right = torch.linalg.cross(forward, up)
        if not float(right.norm()) > 1e-6 * float(up.norm()):
            raise InputError("the camera looks along its up vector: move the eye or give another up")
        right = torch.nn.functional.normalize(right, dim=0)
        return forward, right, torch.linalg.cross(right, forward)

    def directions(self, width: int, height: int) -> Float[Tensor, "H W 3"]:
        """The world direction through the middle of every pixel, float64, not of unit length.

        Raises InputError if the picture has no pixels or the camera looks along its own `up`.
        """
        if width < 1 or height < 1:
            raise InputError(f"size {width}x{height} has no pixels: give width and height from 1")
        x = torch.arange(width, dtype=torch.float64) + 0.5
        y = torch.arange(height, dtype=torch.float64) + 0.5
        return self.through(x[None, :], y[:, None], width, height)

    def through(
        self, x: Float[Tensor, "*#P"], y: Float[Tensor, "*#P"], width: int, height: int
    ) -> Float[Tensor, "*P 3"]:
        """The world directions through points of a picture, in pixels from its upper left corner, float64.

        Raises InputError if the camera looks along its own `up`.
        """
        forward, right, above = self.axes()
        reach = math.tan(math.radians(self.field) / 2)
        across = (2 * x / width - 1) * reach * width / height
        up = (1 - 2 * y / height) * reach
        return forward + across[..., None] * right + up[..., None] * above


def frame(
    positions: Float[Tensor, "V 3"],
    toward: tuple[float, float, float] = (0.45, 0.35, 1.0),
    *,
    aspect: float = 4 / 3,
    field: float = 35.0,
    target: tuple[float, float, float] | None = None,
    distance: float | None = None,
) -> Camera:
    """The camera in direction `toward` (from the model) that holds every vertex in a picture `aspect` as wide as high.

    It looks at `target`, the middle of the bounding box if omitted; straight from above or below, -z is up in the
    picture. `distance` from there takes the place of the one that holds every vertex.
    Raises InputError without points, and if `toward` is no direction, `target` no point, or `aspect`, `field` or
    `distance` leave no picture.
    """
    if len(positions) == 0:
        raise InputError("there is nothing to look at: the model has no vertices")
    direction = torch.tensor(toward, dtype=torch.float64)
    direction = direction / direction.abs().max()
    if not bool(direction.isfinite().all()):
        raise InputError(f"toward is {toward}: give a direction, finite and not zero")
    if not (0 < aspect < math.inf and 0 < field < 180):
        raise InputError(f"aspect is {aspect} and field {field}: give an aspect above 0, a field between 0 and 180")
    if distance is not None and not 0 < distance < math.inf:
        raise InputError(f"distance is {distance}: give a number above 0")
    direction = torch.nn.functional.normalize(direction, dim=0)
    up = (0.0, 1.0, 0.0) if float(direction[[0, 2]].norm()) > STEEP else (0.0, 0.0, -1.0)
    points = positions.to(torch.float64)
    middle = (points.amin(0) + points.amax(0)) / 2
    if target is not None:
        middle = torch.tensor(target, dtype=torch.float64)
        if not bool(middle.isfinite().all()):
            raise InputError(f"target is {target}: give a point, three finite numbers")
    if distance is None:
        distance = _distance(points - middle, direction, torch.tensor(up).double(), aspect, field)
    eye = middle + direction * distance
    x, y, z = eye.tolist()
    u, v, w = middle.tolist()
    return Camera((x, y, z), (u, v, w), up, field)


def _distance(
    points: Float[Tensor, "V 3"], toward: Float[Tensor, "3"], up: Float[Tensor, "3"], aspect: float, field: float
) -> float:
    """From how far a camera that looks at the origin sees all of `points`, with a margin at the frame."""
    right = torch.nn.functional.normalize(torch.linalg.cross(up, toward), dim=0)
    above = torch.linalg.cross(toward, right)
    reach = MARGIN * math.tan(math.radians(field) / 2)
    beside = torch.maximum((points @ right).abs() / aspect, (points @ above).abs()) / reach
    radius = float(points.norm(dim=-1).max())
    # Never so near that the model is around the eye; a single point has no size to measure by.
    return max(float((points @ toward + beside).max()), 1.1 * radius) or 1.0
