"""Pictures and turntables as files of the formats that people have, chosen by the suffix."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import write
from torchprt.preview.encode import encoded, image_of
from torchprt.preview.turntable import save_gif
from torchprt.preview.video import save_mp4
from torchprt.suffixes import MOVIES, PICTURES, TRANSPARENT
from torchprt.words import either

_FORMATS: dict[str, tuple[str, dict[str, Any]]] = {
    ".png": ("PNG", {}),
    # Without subsampling: the colours of small highlights are what a picture of light is about.
    ".jpg": ("JPEG", {"quality": 92, "subsampling": 0}),
    ".jpeg": ("JPEG", {"quality": 92, "subsampling": 0}),
    ".webp": ("WEBP", {"quality": 92, "method": 4}),
}


def save_picture(picture: Float[Tensor, "H W C"], path: str | os.PathLike[str]) -> None:
    """Writes sRGB values in [0, 1] as 8-bit `.png`, `.jpg` or `.webp`; a fourth channel is opacity.

    Raises InputError for another suffix, for opacity in a `.jpg`, or if `path` cannot be written.
    """
    target = Path(path)
    kind, options = _format(target)
    _check_opacity(target, picture)
    write(target, encoded(image_of(picture), format=kind, **options))


def save_movie(
    pictures: Sequence[Float[Tensor, "H W C"]], path: str | os.PathLike[str], rate: float | int = 15.0
) -> None:
    """Writes sRGB pictures in [0, 1], `rate` a second: `.gif`, `.webp` that repeat, `.mp4` (H.264), or numbered files.

    A name with `#` in it, as `frames-####.png`, is a file for each picture, from 0 on, with at least so many digits.
    Raises InputError without pictures, if their sizes differ, for another suffix, unless 0 < rate <= 50 (120 of
    `.mp4`), if `.mp4` is wanted and the package `av` is missing, or if `path` cannot be written.
    """
    target = Path(path)
    if not pictures or len({tuple(picture.shape) for picture in pictures}) != 1:
        raise InputError(f"{target} is to hold {len(pictures)} pictures: give one or more, all of one size")
    suffix = target.suffix.lower()
    if "#" in target.name:
        for number, picture in enumerate(pictures):
            save_picture(picture, target.with_name(numbered(target.name, number)))
        return
    if suffix not in MOVIES:
        raise InputError(f"{target} must end in {either(MOVIES)}, or have # for the numbers")
    _check_opacity(target, pictures[0])
    if suffix == ".gif":
        return save_gif(pictures, target, rate)
    if suffix == ".mp4":
        return save_mp4(pictures, target, rate)
    if not 0 < rate <= 50:
        raise InputError(f"rate is {rate}: give pictures a second, above 0 and up to 50")
    kind, options = _format(target)
    first, *others = (image_of(picture) for picture in pictures)
    # In milliseconds, each the difference of rounded times, so that they add up.
    ends = [round(1000 * (number + 1) / rate) for number in range(len(pictures))]
    durations = [end - start for start, end in zip([0, *ends], ends, strict=False)]
    options = options | {"save_all": True, "append_images": others, "duration": durations, "loop": 0}
    write(target, encoded(first, format=kind, **options))


def numbered(name: str, number: int) -> str:
    """`name` with the last run of `#` replaced by the number, with as many digits or more."""
    found = [*re.finditer("#+", name)][-1]
    return f"{name[: found.start()]}{number:0{len(found[0])}d}{name[found.end() :]}"


def _format(target: Path) -> tuple[str, dict[str, Any]]:
    known = _FORMATS.get(target.suffix.lower())
    if known is None:
        raise InputError(f"{target} must end in {either(PICTURES)}")
    return known


def _check_opacity(target: Path, picture: Tensor) -> None:
    if picture.shape[-1] == 4 and target.suffix.lower() not in TRANSPARENT:
        raise InputError(f"{target} cannot hold transparency: write {either(TRANSPARENT)}")
