"""Radiance pictures (.hdr, .pic) as arrays of linear RGB: flat, old and new run-length coding."""

import re
from pathlib import Path

import numpy as np

from torchprt.errors import InputError

MAGIC = b"#?"

# Pixels; a damaged header must not ask for all memory.
LARGEST = 2**30


def read_rgbe(path: Path) -> np.ndarray:
    """Radiance `[H, W, 3]` float32 of a Radiance picture, in all eight orientations.

    A pixel is `mantissa * 2^(exponent - 136)`, and 0 where the exponent is 0, divided by every EXPOSURE and
    COLORCORR of the header. (Radiance itself adds half a step to the mantissa, other readers do not.)

    Raises InputError if the file is truncated or damaged, or in the XYZE colour space.
    Source: Ward, "Real Pixels", Graphics Gems II (1991); Radiance file formats, "Picture format".
    """
    content = path.read_bytes()
    scale, rows_first, shape, flips, start = _header(path, content)
    quads = _scanlines(path, memoryview(content)[start:], *shape)
    exponent = quads[..., 3].astype(np.int32)
    unit = np.where(exponent > 0, np.ldexp(1.0, exponent - 136), 0.0)
    with np.errstate(over="ignore"):
        image = (quads[..., :3] * unit[..., None] / scale).astype(np.float32)
    for axis, flip in enumerate(flips):
        if flip:
            image = np.flip(image, axis)
    return np.ascontiguousarray(image if rows_first else image.transpose(1, 0, 2))


def _header(path: Path, content: bytes) -> tuple[np.ndarray, bool, tuple[int, int], tuple[bool, bool], int]:
    """Divisor of the pixels, whether scan lines are rows, their number and length, flips, size in bytes."""
    end = content.find(b"\n\n")
    stop = content.find(b"\n", end + 2)
    if end < 0 or stop < 0:
        raise InputError(f"{path} is truncated in its header: get the file again")
    scale = np.ones(3)
    for line in content[:end].decode("latin-1").splitlines():
        key, _, value = line.partition("=")
        if key == "FORMAT" and value.strip() != "32-bit_rle_rgbe":
            raise InputError(f"{path} has pixels of format {value.strip()}: convert it to 32-bit_rle_rgbe")
        if key in ("EXPOSURE", "COLORCORR"):
            try:
                scale = scale * np.array([float(number) for number in value.split()])
            except ValueError as fault:
                raise InputError(f"{path} has an unreadable {key} ({value!r}): get the file again") from fault
    size = content[end + 2 : stop].decode("latin-1")
    match = re.fullmatch(r"([+-])([XY]) (\d+) ([+-])([XY]) (\d+)\s*", size)
    if match is None or match[2] == match[5]:
        raise InputError(f"{path} has an unreadable size ({size[:40]!r}): get the file again")
    # Rows grow downward as Y decreases, columns rightward as X grows.
    forward = {"Y": "-", "X": "+"}
    flips = (match[1] != forward[match[2]], match[4] != forward[match[5]])
    return scale, match[2] == "Y", (int(match[3]), int(match[6])), flips, stop + 1


def _scanlines(path: Path, data: memoryview, lines: int, width: int) -> np.ndarray:
    """`[lines, width, 4]` bytes."""
    if lines * width > LARGEST:
        raise InputError(f"{path} claims {lines} x {width} pixels, which is not credible: get the file again")
    quads = np.empty((lines, width, 4), np.uint8)
    if quads.size == 0:
        return quads
    position = 0
    for line in range(lines):
        lead = bytes(data[position : position + 4])
        if len(lead) == 4 and lead[:2] == b"\2\2" and lead[2] < 128:
            if lead[2] << 8 | lead[3] != width:
                raise InputError(f"{path} is damaged in scan line {line}: get the file again")
            row, position = _new_runs(path, data, position + 4, width)
            quads[line] = row.reshape(4, width).T
        else:
            quads[line:] = _old_runs(path, data[position:], (lines - line) * width).reshape(-1, width, 4)
            break
    return quads


def _new_runs(path: Path, data: memoryview, position: int, width: int) -> tuple[np.ndarray, int]:
    """One scan line: the four components one after the other, each in runs and literals."""
    pieces = []
    for _ in range(4):
        left = width
        while left:
            count = data[position] if position < len(data) else 0
            if count > 128:
                count -= 128
                piece = bytes(data[position + 1 : position + 2]) * count
                position += 2
            else:
                piece = bytes(data[position + 1 : position + 1 + count])
                position += 1 + count
            if count == 0 or count > left or len(piece) != count:
                raise InputError(f"{path} is truncated or damaged: get the file again")
            pieces.append(piece)
            left -= count
    return np.frombuffer(b"".join(pieces), np.uint8), position


def _old_runs(path: Path, data: memoryview, total: int) -> np.ndarray:
    """Pixels one after the other; mantissas 1, 1, 1 repeat the last pixel, consecutive ones in base 256."""
    quads = np.frombuffer(data[: len(data) // 4 * 4], np.uint8).reshape(-1, 4)[:total]
    repeats = (quads[:, :3] == 1).all(axis=1)
    index = np.arange(len(quads))
    source = np.maximum.accumulate(np.where(repeats, -1, index))
    digit = index - source - 1
    if len(quads) and (source[0] < 0 or digit.max(initial=0) > 3):
        raise InputError(f"{path} is damaged (a run without a pixel to repeat): get the file again")
    counts = np.where(repeats, quads[:, 3].astype(np.int64) << 8 * np.maximum(digit, 0), 1)
    reached = np.cumsum(counts)
    last = int(np.searchsorted(reached, total))
    if last == len(quads):
        raise InputError(f"{path} is truncated: get the file again")
    if reached[last] != total:
        raise InputError(f"{path} is damaged (a run passes the end of the picture): get the file again")
    return np.repeat(quads[source[: last + 1]], counts[: last + 1], axis=0)
