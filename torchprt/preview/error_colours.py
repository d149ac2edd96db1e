"""Colours of an error at every vertex, for a picture of where an approximation fails."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

# Blue, cyan, green, yellow, red.
_SCALE = ((0.0, 0.0, 1.0), (0.0, 1.0, 1.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0), (1.0, 0.0, 0.0))


def error_colours(error: Float[Tensor, "V"], most: float | int) -> Float[Tensor, "V 3"]:
    """sRGB of each error on a linear scale: blue is 0, then cyan, green and yellow, red is `most` and all above.

    `Still.radiance` of the result is the picture, sRGB as it is.
    Raises InputError if an error is negative or not finite, or `most` is not positive.
    Source: figure 4 of Sloan, Hall, Hart and Snyder 2003.
    """
    if not 0 < most < float("inf"):
        raise InputError(f"most is {most}: the scale ends at a positive number")
    if not (error.isfinite() & (error >= 0)).all():
        raise InputError("error holds a number that is negative or not finite: pass squared or absolute errors")
    steps = len(_SCALE) - 1
    # In float64 an error just below a step cannot round past it.
    place = (error.double() / most).clamp(max=1) * steps
    lower = place.floor().clamp(max=steps - 1)
    scale = torch.tensor(_SCALE, dtype=torch.float64, device=error.device)
    along = (place - lower)[:, None]
    return torch.lerp(scale[lower.long()], scale[lower.long() + 1], along).to(error.dtype)
