"""Turntables as `.mp4`, by PyAV."""

from __future__ import annotations

import os
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import atomic

FASTEST = 120
"""Pictures a second."""
# Of H.264: what is hardly told from the original.
_QUALITY = "16"


def check_video() -> Any:
    """The package that reads and writes videos. Raises InputError if it is not there."""
    try:
        import av
    except ImportError as fault:
        raise InputError(
            "a video needs the package av: pip install 'torchprt[video]', or write .gif or .webp"
        ) from fault
    return av


def save_mp4(
    pictures: Sequence[Float[Tensor, "H W 3"]], path: str | os.PathLike[str], rate: float | int = 15.0
) -> None:
    """Writes sRGB pictures in [0, 1] as H.264, `rate` a second, so that any browser plays it.

    An odd side is made even by repeating its last row of pixels, because the format halves the resolution of colour.
    Raises InputError without pictures, unless 0 < rate <= 120, if the package `av` is missing, or if `path` cannot be
    written.
    """
    if not pictures or not 0 < rate <= FASTEST:
        raise InputError(f"{len(pictures)} pictures at {rate} a second: give one or more at a rate up to {FASTEST}")
    av = check_video()
    height, width, _ = pictures[0].shape
    with atomic(Path(path)) as temporary, av.open(str(temporary), "w", options={"movflags": "faststart"}) as file:
        stream = file.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000))
        stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        stream.options = {"crf": _QUALITY, "preset": "medium"}
        # BT.709, as browsers take it.
        stream.codec_context.colorspace = stream.codec_context.color_primaries = stream.codec_context.color_trc = 1
        for picture in pictures:
            values = (picture.detach().cpu().clamp(0, 1) * 255).round().to(torch.uint8)
            values = torch.cat([values, values[-1:]])[: stream.height]
            values = torch.cat([values, values[:, -1:]], 1)[:, : stream.width]
            frame = av.VideoFrame.from_ndarray(values.contiguous().numpy(), format="rgb24")
            file.mux(stream.encode(frame.reformat(format="yuv420p", dst_colorspace="ITU709")))
        file.mux(stream.encode())


def measure_video(path: str | os.PathLike[str]) -> tuple[int, tuple[int, int], float]:
    """How many pictures a video has, their width and height, and the seconds that it lasts.

    Raises InputError, naming the file, if it is no video, or if the package `av` is missing.
    """
    av = check_video()
    try:
        with av.open(str(path)) as file:
            stream = file.streams.video[0]
            pictures = stream.frames or sum(1 for _ in file.decode(stream))
            seconds = float(stream.duration * stream.time_base) if stream.duration else 0.0
            return pictures, (stream.width, stream.height), seconds
    except (OSError, IndexError, av.FFmpegError) as fault:
        raise InputError(f"{path} is not a whole video: write it again") from fault
