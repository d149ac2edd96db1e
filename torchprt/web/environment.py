"""The lights that a page offers, and what it reads of each."""

from __future__ import annotations

import math
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.preview.environment import Environment, photograph
from torchprt.shade import display

# Rows of the pictures that a page holds, twice as many columns.
ROWS = 256
# Half angle of a sample's sun: wide enough for the orders at hand.
SUN = math.radians(12)
_REAL_SUN = math.radians(0.2665)
_LUMINANCE = (0.2126, 0.7152, 0.0722)


def samples(order: int) -> list[Environment]:
    """Four lights to begin with: a studio, a clear noon, a low sun, an overcast sky. None need be downloaded.

    The suns are discs of 12 degrees half angle with the irradiance of the sun. Each light has the least window that
    keeps it positive, so that it does not ring.
    """
    images = {
        "Studio": light.studio(ROWS),
        "Clear noon": _day(math.radians(55), 2.5),
        "Low sun": _day(math.radians(14), 4.0),
        "Overcast": _overcast(),
    }
    return [Environment(name, sh.least_window(light.project(image, order))[0], image) for name, image in images.items()]


def _day(elevation: float, turbidity: float) -> Float[Tensor, "H W 3"]:
    toward = torch.tensor([0.7 * math.cos(elevation), math.sin(elevation), 0.714 * math.cos(elevation)]).double()
    toward = toward / toward.norm()
    directions = sh.latlong_directions(ROWS, 2 * ROWS)
    sky = light.clear_sky_radiance(directions.reshape(-1, 3), toward, turbidity).reshape(ROWS, 2 * ROWS, 3)
    sun = light.sun_radiance(torch.tensor(math.pi / 2 - elevation).double(), turbidity)
    blurred = sun * (math.sin(_REAL_SUN) / math.sin(SUN)) ** 2
    above = directions[..., 1:2] > 0
    radiance = sky + torch.where((directions @ toward > math.cos(SUN))[..., None] & above, blurred, 0.0)
    weights = sh.latlong_weights(ROWS, 2 * ROWS)[..., None] * directions[..., 1:2].clamp(min=0)
    ground = 0.2 / math.pi * (radiance * weights).sum((0, 1))
    return torch.where(above, radiance, ground).float()


def _overcast() -> Float[Tensor, "H W 3"]:
    height = sh.latlong_directions(ROWS, 2 * ROWS, dtype=torch.float32)[..., 1:2]
    return torch.where(height > 0, (1 + 2 * height) / 3, 7 / 9 * 0.2).expand(-1, -1, 3)


def of_order(environment: Environment, order: int) -> Float[Tensor, "N 3"]:
    """The first `order` bands of its light. Raises InputError if it has fewer, or a value that is not finite."""
    if len(environment.light) < order**2:
        raise InputError(
            f"the light {environment.name} has {len(environment.light)} coefficients: project it to order {order}"
        )
    if not bool(environment.light.isfinite().all()):
        raise InputError(f"the light {environment.name} holds values that are not finite: repair its image")
    return environment.light[: order**2].float()


def as_json(environment: Environment, order: int, picture: str, exposure: float) -> dict[str, Any]:
    """What the page reads of an environment; `exposure` in stops, `lamp` for N.L."""
    coefficients = of_order(environment, order)
    direction, radiance = light.dominant(coefficients.double())
    return {
        "name": environment.name,
        "picture": picture,
        "exposure": exposure,
        "coefficients": coefficients.tolist(),
        "lamp": {"direction": direction.tolist(), "colour": radiance.tolist()},
    }


def shown(environment: Environment) -> Float[Tensor, "h w 3"]:
    """Its picture as sRGB in [0, 1], small, exposed so that its mean without the lamps is a middle grey."""
    picture = photograph(environment.light.float(), ROWS) if environment.image is None else environment.image.float()
    if picture.shape[0] > ROWS:
        columns = torch.nn.functional.interpolate(picture.movedim(-1, 0)[None], (ROWS, 2 * ROWS), mode="area")
        picture = columns[0].movedim(0, -1)
    bright = luminance(picture.clamp(min=0))
    middle = float(bright.clamp(max=4 * float(bright.median())).mean())
    return display(picture.clamp(min=0), exposure=math.log2(0.3 / middle) if middle > 0 else 0.0)


def luminance(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S"]:
    """Rec. 709."""
    return radiance @ torch.tensor(_LUMINANCE, dtype=radiance.dtype)
