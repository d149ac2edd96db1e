"""Environments that are always there, so that nothing need be downloaded: studios and skies, in the order of a day."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError
from torchprt.light.sky import clear_sky_radiance
from torchprt.light.studio import soft_boxes, studio
from torchprt.light.sun import HALF_ANGLE, sun_radiance

SUN = math.radians(12)
"""Half angle of the suns: wide enough for the orders at hand, of the irradiance of the sun."""
AZIMUTH = (0.7, 0.714)
"""Where the suns stand, along +x and +z: to the right of whoever looks along -z, and behind him."""
GROUND_ALBEDO = 0.2
DAYLIGHT = (1.026, 0.9845, 1.077)
"""What sun and sky at noon bring to level ground, of luminance 1: white to a camera that is set to daylight."""
# Directions, half widths and half heights as tangents, and radiance of a key at 45 degrees, a fill from the other side
# with a quarter of its irradiance, and a rim light from behind; all of one white.
THREE_POINT = (
    ((0.8, 0.7, 0.8), (0.3, 0.3), (24.0, 24.0, 24.0)),
    ((-1.0, 0.25, 0.7), (0.45, 0.45), (2.7, 2.7, 2.7)),
    ((-0.45, 0.75, -1.0), (0.35, 0.2), (16.0, 16.0, 16.0)),
)
DARK = 0.12
"""Radiance of the room around the three lamps."""


def built_in(name: str, height: int = 256) -> Float[Tensor, "H W 3"]:
    """Linear radiance `[height, 2 height, 3]` of one of `BUILT_IN`, which turns as any environment does.

    - "studio": a warm key, a cool fill and a warm rim light in a dim room.
    - "three-point": white key, fill and rim light in a dark room: shape without colour.
    - "sky": a clear sky at noon, its sun at 55 degrees.
    - "sunset": a clear sky with a low, warm sun, at 9 degrees.
    - "overcast": the CIE overcast sky, soft light from above.
    - "white": the same from everywhere: what is dark is occluded.

    Suns are discs of 12 degrees half angle with the irradiance of the sun; grounds have an albedo of .2. Colours are
    balanced for daylight: the sky at noon lights level ground in white.
    Raises InputError for another name, and if `height` is below 2.
    """
    if name not in BUILT_IN:
        raise InputError(f"there is no light '{name}': give {', '.join(BUILT_IN[:-1])} or {BUILT_IN[-1]}")
    if height < 2:
        raise InputError(f"height is {height}: give at least 2 rows")
    return _MAKERS[name](height)


def _three_point(height: int) -> Tensor:
    return soft_boxes(torch.full((height, 2 * height, 3), DARK), THREE_POINT)


def _day(elevation: float, turbidity: float, height: int) -> Tensor:
    """A clear sky, its widened sun and the ground that both light."""
    level = math.cos(elevation)
    toward = torch.tensor([AZIMUTH[0] * level, math.sin(elevation), AZIMUTH[1] * level], dtype=torch.float64)
    toward = toward / toward.norm()
    directions = sh.latlong_directions(height, 2 * height)
    sky = clear_sky_radiance(directions.reshape(-1, 3), toward, turbidity).reshape(height, 2 * height, 3)
    sun = sun_radiance(torch.tensor(math.pi / 2 - elevation, dtype=torch.float64), turbidity)
    blurred = sun * (math.sin(HALF_ANGLE) / math.sin(SUN)) ** 2
    above = directions[..., 1:2] > 0
    radiance = sky + torch.where((directions @ toward > math.cos(SUN))[..., None] & above, blurred, 0.0)
    weights = sh.latlong_weights(height, 2 * height)[..., None] * directions[..., 1:2].clamp(min=0)
    ground = GROUND_ALBEDO / math.pi * (radiance * weights).sum((0, 1))
    return (torch.where(above, radiance, ground) / torch.tensor(DAYLIGHT).double()).float()


def _overcast(height: int) -> Tensor:
    up = sh.latlong_directions(height, 2 * height, dtype=torch.float32)[..., 1:2]
    return torch.where(up > 0, (1 + 2 * up) / 3, 7 / 9 * GROUND_ALBEDO).expand(-1, -1, 3)


_MAKERS: dict[str, Callable[[int], Tensor]] = {
    "studio": studio,
    "three-point": _three_point,
    "sky": lambda height: _day(math.radians(55), 2.5, height),
    "sunset": lambda height: _day(math.radians(9), 4.0, height),
    "overcast": _overcast,
    "white": lambda height: torch.ones(height, 2 * height, 3),
}
BUILT_IN = tuple(_MAKERS)
