"""Reading environment images: radiance that can be used, and a word on what had to be done to it."""

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.light import exr, rgbe
from torchprt.light.damage import DamagedImageWarning, ImageReport, mend
from torchprt.suffixes import check_readable, refuse_other


def read(path: str | os.PathLike[str], *, repair: bool = False) -> Float[Tensor, "H W 3"]:
    """Linear radiance `[H, W, 3]` float32 of an image file, told by its content, not by its suffix.

    - OpenEXR (`.exr`): see `exr.read_exr`. Radiance (`.hdr`): see `rgbe.read_rgbe`. Both are linear.
    - Pictures (`.png`, `.jpg`, `.tif` and what else Pillow reads): 8 bits, or 16 bits in one channel, decoded
      from sRGB to linear [0, 1]; alpha is dropped, grey repeated, the EXIF orientation applied.

    Negative values become 0. Values that are not finite are refused, or with `repair` replaced by the median
    of their finite neighbours. Either, and a sun with a dead channel, is told by a `DamagedImageWarning`.

    Raises InputError if the file is missing, empty, truncated, no image, without pixels, or not finite.
    """
    image, report = read_with_report(path, repair=repair)
    if report.damaged:
        warnings.warn(f"{path}: {report}", DamagedImageWarning, stacklevel=2)
    return image


def read_with_report(
    path: str | os.PathLike[str], *, repair: bool = False
) -> tuple[Float[Tensor, "H W 3"], ImageReport]:
    """As `read`, but what was found and done is returned instead of warned of."""
    file = check_readable(path)
    try:
        with file.open("rb") as stream:
            lead = stream.read(4)
        if not lead:
            raise InputError(f"{path} is empty: get the file again")
        if lead == exr.MAGIC:
            pixels = exr.read_exr(file)
        elif lead.startswith(rgbe.MAGIC):
            pixels = rgbe.read_rgbe(file)
        else:
            pixels = _read_picture(file)
    except OSError as fault:
        reason = fault.strerror or str(fault)
        raise InputError(f"{path} cannot be read ({reason}): check the name and the permissions") from fault
    if pixels.size == 0:
        raise InputError(f"{path} has no pixels ({pixels.shape[0]} x {pixels.shape[1]}): get the file again")
    return mend(torch.from_numpy(pixels), str(path), repair)


def _read_picture(path: Path) -> np.ndarray:
    import PIL.Image
    import PIL.ImageOps

    try:
        with PIL.Image.open(path) as opened:
            _check_depth(path, opened)
            picture = PIL.ImageOps.exif_transpose(opened)
    except PIL.UnidentifiedImageError as fault:
        refuse_other(path, "an image")
        raise InputError(f"{path} is no image that can be read: give an .exr, .hdr, .png or .jpg") from fault
    except (OSError, SyntaxError, ValueError, EOFError, PIL.Image.DecompressionBombError) as fault:
        raise InputError(f"{path} is damaged or truncated ({fault}): get the file again") from fault
    if picture.mode.startswith("I;16"):
        encoded = np.repeat(np.asarray(picture)[..., None], 3, axis=-1) / 65535.0
    elif picture.mode in ("1", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX"):
        encoded = np.asarray(picture.convert("RGBA").convert("RGB")) / 255.0
    else:
        raise InputError(f"{path} has pixels of mode {picture.mode}: convert it to RGB of 8 bits, or to .exr")
    # IEC 61966-2-1.
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


def _check_depth(path: Path, opened: Any) -> None:
    """Pillow cuts colour PNGs of 16 bits to 8 without a word."""
    if opened.format != "PNG" or opened.mode not in ("RGB", "RGBA", "LA"):
        return
    with path.open("rb") as stream:
        depth = stream.read(25)[24]
    if depth == 16:
        raise InputError(f"{path} is a colour PNG of 16 bits, of which 8 would be lost: convert it to .exr")
