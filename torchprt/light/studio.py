"""A procedural environment: soft boxes in a dim room, so that nothing need be downloaded to see light turn."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError

Vector = tuple[float, float, float]
Lamp = tuple[Vector, tuple[float, float], Vector]

# Direction of the middle, half width and half height as tangents, radiance.
LAMPS = (
    ((0.75, 0.75, 0.45), (0.35, 0.35), (26.0, 22.0, 17.0)),
    ((-1.0, 0.25, 0.3), (0.2, 0.6), (2.5, 4.0, 7.0)),
    ((0.1, 0.35, -1.0), (0.8, 0.15), (6.0, 3.0, 2.0)),
)
CEILING, WALL, FLOOR = (0.35, 0.38, 0.42), (0.22, 0.22, 0.24), (0.12, 0.10, 0.08)


def studio(height: int = 128) -> Float[Tensor, "H W 3"]:
    """Linear radiance `[height, 2 height, 3]` of a room with a warm key, a cool fill and a rim light.

    The key stands to the right (+x), above and in front (+z); the rim light behind (-z), in the middle of the map.
    Raises InputError if `height` is below 2.
    """
    if height < 2:
        raise InputError(f"height is {height}: give at least 2 rows")
    directions = sh.latlong_directions(height, 2 * height, dtype=torch.float32)
    above = directions[..., 1:2]
    floor, wall, ceiling = (torch.tensor(colour) for colour in (FLOOR, WALL, CEILING))
    room = torch.where(
        above > 0, torch.lerp(wall, ceiling, above.clamp(min=0)), torch.lerp(wall, floor, (-above).clamp(min=0))
    )
    return soft_boxes(room, LAMPS)


def soft_boxes(room: Float[Tensor, "H W 3"], lamps: Sequence[Lamp]) -> Float[Tensor, "H W 3"]:
    """A latitude-longitude map with rectangular lamps over it.

    Of a lamp: the direction of its middle, half its width and half its height as tangents, its radiance.
    """
    directions = sh.latlong_directions(room.shape[0], room.shape[1], dtype=torch.float32)
    for middle, (width, tall), radiance in lamps:
        forward = torch.nn.functional.normalize(torch.tensor(middle), dim=0)
        right = torch.nn.functional.normalize(torch.linalg.cross(torch.tensor([0.0, 1.0, 0.0]), forward), dim=0)
        up = torch.linalg.cross(forward, right)
        ahead = directions @ forward
        x, y = (directions @ right / ahead).abs(), (directions @ up / ahead).abs()
        room = torch.where(((ahead > 0) & (x < width) & (y < tall))[..., None], torch.tensor(radiance), room)
    return room
