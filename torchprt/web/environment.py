"""What a page offers as light: coefficients, and a picture to choose by and to stand behind the model."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import light, sh
from torchprt.errors import InputError
from torchprt.shade import display

# Rows of the pictures that a page holds, twice as many columns.
ROWS = 192
_LUMINANCE = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class Environment:
    """A light by name: `coefficients [N, 3]` and `picture [H, 2 H, 3]`, its radiance as latitude-longitude map."""

    name: str
    coefficients: Tensor
    picture: Tensor

    def __post_init__(self) -> None:
        height, *rest = self.picture.shape
        if rest != [2 * height, 3]:
            raise InputError(
                f"the picture of {self.name} has shape {list(self.picture.shape)}: it must be a latitude-longitude "
                "map, twice as wide as high"
            )
        sh.order_of(self.coefficients.shape[0])


def from_image(name: str, image: Float[Tensor, "H W 3"], order: int) -> Environment:
    """Projects a latitude-longitude map of linear radiance. Raises InputError if it is none."""
    return Environment(name, light.project(image, order).float(), image.float())


def from_coefficients(name: str, coefficients: Float[Tensor, "N 3"]) -> Environment:
    """A light that is only known by its coefficients; the picture is what they say, black where that is negative."""
    directions = sh.latlong_directions(ROWS, 2 * ROWS, dtype=torch.float32)
    picture = sh.evaluate(coefficients.float(), directions.reshape(-1, 3)).reshape(ROWS, 2 * ROWS, 3)
    return Environment(name, coefficients.float(), picture.clamp(min=0))


def samples(order: int) -> list[Environment]:
    """Four lights to begin with: a studio, a clear noon, a low sun, an overcast sky. None need be downloaded.

    The suns are discs of 12 degrees half angle with the irradiance of the sun. All but the overcast sky have the least
    window that keeps them positive, so that they do not ring.
    """
    overcast = light.overcast_sky((1.0, 1.0, 1.0), (0.0, 1.0, 0.0), order).float()
    return [
        _calm(from_image("Studio", light.studio(ROWS), order)),
        _day("Clear noon", math.radians(55), 2.5, order),
        _day("Low sun", math.radians(14), 4.0, order),
        Environment("Overcast", overcast, _overcast()),
    ]


def _day(name: str, elevation: float, turbidity: float, order: int) -> Environment:
    toward = torch.tensor([0.7 * math.cos(elevation), math.sin(elevation), 0.714 * math.cos(elevation)]).double()
    toward = toward / toward.norm()
    half = math.radians(12)
    directions = sh.latlong_directions(ROWS, 2 * ROWS)
    sky = light.clear_sky_radiance(directions.reshape(-1, 3), toward, turbidity).reshape(ROWS, 2 * ROWS, 3)
    sun = light.sun_radiance(torch.tensor(math.pi / 2 - elevation).double(), turbidity)
    blurred = sun * (math.sin(math.radians(0.2665)) / math.sin(half)) ** 2
    above = directions[..., 1:2] > 0
    radiance = sky + torch.where(((directions @ toward) > math.cos(half))[..., None] & above, blurred, 0.0)
    weights = sh.latlong_weights(ROWS, 2 * ROWS)[..., None] * directions[..., 1:2].clamp(min=0)
    ground = 0.2 / math.pi * (radiance * weights).sum((0, 1))
    return _calm(from_image(name, torch.where(above, radiance, ground).float(), order))


def _calm(environment: Environment) -> Environment:
    return replace(environment, coefficients=sh.least_window(environment.coefficients)[0])


def _overcast() -> Tensor:
    height = sh.latlong_directions(ROWS, 2 * ROWS, dtype=torch.float32)[..., 1:2]
    return torch.where(height > 0, (1 + 2 * height) / 3, 7 / 9 * 0.2).expand(-1, -1, 3)


def as_json(environment: Environment, picture: str, exposure: float) -> dict[str, Any]:
    """What the page reads of an environment; `exposure` in stops, `lamp` for N.L."""
    direction, radiance = light.dominant(environment.coefficients.double())
    return {
        "name": environment.name,
        "picture": picture,
        "exposure": exposure,
        "coefficients": environment.coefficients.tolist(),
        "lamp": {"direction": direction.tolist(), "colour": radiance.tolist()},
    }


def shown(environment: Environment) -> Float[Tensor, "h w 3"]:
    """The picture as sRGB in [0, 1], small, exposed so that its mean is a middle grey."""
    columns = environment.picture.permute(2, 0, 1)[None]
    if environment.picture.shape[0] > ROWS:
        columns = torch.nn.functional.interpolate(columns, (ROWS, 2 * ROWS), mode="area")
    picture = columns[0].permute(1, 2, 0).clamp(min=0)
    bright = luminance(picture).clamp(max=4 * float(luminance(picture).median()) + 1e-30).mean()
    return display(picture, exposure=math.log2(0.3 / max(float(bright), 1e-30)))


def luminance(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S"]:
    """Rec. 709."""
    return radiance @ torch.tensor(_LUMINANCE, dtype=radiance.dtype)
