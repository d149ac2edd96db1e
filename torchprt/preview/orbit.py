"""A camera that goes around a point: what drags and the wheel move."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.preview.camera import Camera, frame

STEEPEST = math.radians(89.5)
"""How far above or below the camera may look from: at 90 degrees it would look along its up."""
NEAREST, FARTHEST = 0.05, 20.0
"""How near and far the wheel goes, in distances of the first view."""
STEP = 0.9
"""What a step of the wheel does to the distance."""


@dataclass(frozen=True)
class Orbit:
    """Looks at `target` from `distance`, `yaw` from +z to +x about +y and `pitch` upward, in radians."""

    target: tuple[float, float, float]
    distance: float
    yaw: float
    pitch: float
    first: float
    field: float = 35.0

    @classmethod
    def around(
        cls,
        positions: Float[Tensor, "V 3"],
        toward: tuple[float, float, float] = (0.45, 0.35, 1.0),
        *,
        aspect: float = 1.0,
        sides: int = 1,
        field: float = 35.0,
        target: tuple[float, float, float] | None = None,
        distance: float | None = None,
    ) -> Orbit:
        """The orbit whose first camera is that of `frame`, or up to 0.5 degrees beside it if that looks straight down.

        `sides`: from how many sides around the model it is seen whole, from the distance of the farthest of them.
        `field`, `target`, `distance` as in `frame`.
        Raises InputError as `frame`.
        """
        x, y, z = toward
        turns = [2 * math.pi * side / sides for side in range(sides)]
        views = [
            (x * math.cos(turn) + z * math.sin(turn), y, z * math.cos(turn) - x * math.sin(turn)) for turn in turns
        ]
        cameras = [
            frame(positions, view, aspect=aspect, field=field, target=target, distance=distance) for view in views
        ]
        away = max(math.dist(camera.eye, camera.target) for camera in cameras)
        length = math.hypot(x, y, z)
        pitch = max(-STEEPEST, min(STEEPEST, math.asin(y / length)))
        return cls(cameras[0].target, away, math.atan2(x, z), pitch, away, cameras[0].field)

    def camera(self) -> Camera:
        level = math.cos(self.pitch)
        away = (math.sin(self.yaw) * level, math.sin(self.pitch), math.cos(self.yaw) * level)
        x, y, z = (middle + self.distance * part for middle, part in zip(self.target, away, strict=True))
        return Camera((x, y, z), self.target, field=self.field)

    def turned(self, right: float | int, down: float | int) -> Orbit:
        """After a drag of the model's near side by these angles in radians."""
        pitch = max(-STEEPEST, min(STEEPEST, self.pitch + down))
        return replace(self, yaw=math.remainder(self.yaw - right, 2 * math.pi), pitch=pitch)

    def zoomed(self, steps: float | int) -> Orbit:
        """Nearer by `steps` of the wheel."""
        distance = self.distance * STEP**steps
        return replace(self, distance=max(NEAREST * self.first, min(FARTHEST * self.first, distance)))


def dragged(
    rotation: Float[Tensor, "3 3"], camera: Camera, right: float | int, down: float | int
) -> Float[Tensor, "3 3"]:
    """`rotation` followed by a drag of the near side of the world: about the camera's up, then about its right."""
    _, sideways, above = camera.axes()
    turn = _about(sideways, down) @ _about(above, right) @ rotation.double()
    # A thousand drags must not wear a rotation off.
    u, _, v = torch.linalg.svd(turn)
    return (u @ v).to(rotation.dtype)


def _about(axis: Float[Tensor, "3"], angle: float | int) -> Float[Tensor, "3 3"]:
    x, y, z = (angle * axis).tolist()
    return torch.linalg.matrix_exp(torch.tensor([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]], dtype=torch.float64))
