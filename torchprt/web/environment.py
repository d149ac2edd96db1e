"""The lights that a page offers, and what it reads of each."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import light
from torchprt.errors import InputError
from torchprt.preview.environment import Environment, built_in_environment, photograph
from torchprt.shade import display
from torchprt.shade.white import LUMINANCE

# Rows of the pictures that a page holds, twice as many columns.
ROWS = 256


def samples(order: int) -> list[Environment]:
    """The built-in lights, from a studio to the same light from everywhere. None need be downloaded.

    Each has the least window that keeps it positive, so that it does not ring.
    """
    found = [built_in_environment(name, order) for name in light.BUILT_IN]
    return [replace(each, name=each.name.capitalize()) for each in found]


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
    return radiance @ torch.tensor(LUMINANCE, dtype=radiance.dtype)
