"""A map of radiance or irradiance as a file that engines read."""

from __future__ import annotations

import math
import os
from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import write_array
from torchprt.light import write_exr
from torchprt.preview.picture import save_png
from torchprt.shade import display
from torchprt.shade.display import TONE, ToneMap
from torchprt.transfer import Receivers
from torchprt.words import either

MAPS = (".exr", ".png", ".npy")


def save_map(
    receivers: Receivers,
    values: Float[Tensor, "V 3"],
    path: str | os.PathLike[str],
    *,
    exposure: float | int = 0.0,
    tone: ToneMap = TONE,
) -> None:
    """Writes values of the texels of an atlas as a map with its gutters, row 0 above; black where there is nothing.

    `.exr` holds them as they are, linear, in half floats (11 bits, up to 65504); `.npy` in float32,
    `[rows, columns, 3]`; `.png` as pictures are shown, in sRGB of 8 bits, under an `exposure` in stops and a tone map.
    Raises InputError if the receivers are no texels of a map, for another suffix, if a value does not fit into an
    `.exr`, or `path` cannot be written.
    """
    target = Path(path)
    image = receivers.as_atlas().image(values.float())
    suffix = target.suffix.lower()
    if suffix == ".exr":
        write_exr(target, image.numpy())
    elif suffix == ".npy":
        write_array(target, image.contiguous().numpy())
    elif suffix == ".png":
        save_png(display(image, exposure=exposure, tone=tone), target)
    else:
        raise InputError(f"{target} must end in {either(MAPS)}: a map is written as one of these")


def irradiance_exposure(exposure: float) -> float:
    """Stops at which irradiance looks as the radiance of a white surface under it does at `exposure`."""
    return exposure - math.log2(math.pi)
