"""OpenEXR files as arrays of linear RGB."""

import errno
import os
from pathlib import Path

import numpy as np
from jaxtyping import Float

from torchprt.errors import InputError
from torchprt.files import atomic

MAGIC = b"\x76\x2f\x31\x01"
HALF = 65504
"""The largest half float."""

# Red, green, blue and white of Rec. 709, which OpenEXR assumes when a file does not say otherwise.
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


def read_exr(path: Path) -> np.ndarray:
    """Radiance `[H, W, 3]` float32 of an OpenEXR file: scan lines or tiles, half, float or unsigned channels.

    The channels are R, G, B, or those of the one layer that has them (`Combined.R`...), or Y alone, which is
    repeated. Alpha and every other channel is dropped. The first part with colour is read.

    Raises InputError if the file is damaged or truncated, holds no such channels or several layers of them,
    subsamples its channels, is a crop of a larger picture, or states primaries other than Rec. 709.
    """
    import OpenEXR  # here, so that importing torchprt.light stays light

    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            parts = [(dict(part.header), dict(part.channels)) for part in file.parts]
    except Exception as fault:
        # The bindings raise RuntimeError, TypeError or ValueError as the fault happens to be met.
        raise InputError(f"{path} is damaged or truncated ({fault}): get the file again") from fault
    if not parts:
        # The bindings drop a part that they cannot decode and go on.
        raise InputError(f"{path} is damaged or truncated (no part of it can be decoded): get the file again")
    for header, channels in parts:
        names = _colour(path, list(channels))
        if names:
            _check_header(path, header)
            return _stack(path, [channels[name] for name in names])
    found = ", ".join(sorted({name for _, channels in parts for name in channels})) or "none"
    raise InputError(f"{path} has no channels R, G, B or Y (found: {found}): save it as RGB")


def write_exr(path: str | os.PathLike[str], image: Float[np.ndarray, "H W 3"]) -> None:
    """Writes linear RGB of Rec. 709 as OpenEXR of half floats, which have 11 bits and reach to 65504.

    Raises InputError if a number is not finite or does not fit, or `path` cannot be written.
    """
    import OpenEXR

    most = np.abs(image).max(initial=0)
    # NaN too.
    if not most <= HALF:
        raise InputError(
            f"{path} would hold a number of {most:.3g}, and half floats reach to {HALF}: write .npy, or take a weaker "
            "light"
        )
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with atomic(path) as temporary:
        pixels = np.ascontiguousarray(image, np.float16)
        OpenEXR.File(header, {"RGB": pixels}).write(str(temporary))
        # The library does not notice when a disk does not take the last part.
        if not _holds(temporary, pixels):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _holds(path: Path, pixels: Float[np.ndarray, "H W 3"]) -> bool:
    """Whether a file can be read, and has these pixels."""
    import OpenEXR

    try:
        with OpenEXR.File(str(path)) as file:
            return np.array_equal(file.channels()["RGB"].pixels, pixels)
    except (RuntimeError, TypeError, ValueError, KeyError, IndexError):
        return False


def _colour(path: Path, names: list[str]) -> list[str]:
    """The names of red, green and blue, or of luminance three times, or nothing."""
    layers: dict[str, dict[str, str]] = {}
    for name in names:
        layer, _, last = name.rpartition(".")
        layers.setdefault(layer, {})[last.lower()] = name
    wanted = {"r": 0, "g": 1, "b": 2}
    coloured = {layer: found for layer, found in layers.items() if wanted.keys() <= found.keys()}
    if not coloured and "y" in layers.get("", {}):
        if {"ry", "by"} & layers[""].keys():
            raise InputError(f"{path} stores luminance and chroma (Y, RY, BY): save it as RGB")
        return [layers[""]["y"]] * 3
    if "" in coloured:
        coloured = {"": coloured[""]}
    if len(coloured) > 1:
        raise InputError(f"{path} has several layers of colour ({', '.join(coloured)}): save one of them")
    return [found[letter] for found in coloured.values() for letter in wanted]


def _check_header(path: Path, header: dict) -> None:
    data, display = np.array(header["dataWindow"]), np.array(header["displayWindow"])
    if not np.array_equal(data, display):
        windows = f"data window {data.tolist()}, display window {display.tolist()}"
        raise InputError(f"{path} is a crop ({windows}): save it whole")
    stated = header.get("chromaticities")
    if stated is not None and not np.allclose(np.ravel(stated), REC709, atol=2e-3):
        raise InputError(f"{path} states primaries other than Rec. 709 ({stated}): convert it to Rec. 709")


def _stack(path: Path, channels: list) -> np.ndarray:
    if any(channel.xSampling != 1 or channel.ySampling != 1 for channel in channels):
        raise InputError(f"{path} subsamples its channels: save it at full resolution")
    pixels = [np.asarray(channel.pixels) for channel in channels]
    if any(plane.ndim != 2 or plane.dtype == object for plane in pixels):
        raise InputError(f"{path} is a deep image: flatten it first")
    return np.stack([plane.astype(np.float32) for plane in pixels], axis=-1)
