"""NanoVDB: grids of floats, by Warp, on the CPU."""

from __future__ import annotations

import functools
import inspect
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchprt.errors import InputError

from .volume_grid import Grid, chosen, placed

_FLOAT = 1
# The headers of a file and of each grid in it (NanoVDB.h: FileHeader, FileMetaData).
_FILE, _GRID = "<QIHH", "<QQQQII6d6i3dI4I3IHHI"


class _Entry(NamedTuple):
    name: str
    type: int
    box: tuple[int, ...]


def read_nanovdb(file: Path, grid: str | None) -> Grid:
    """The grid of floats in an `.nvdb` file, as `read_volume` says.

    Raises InputError if the package `warp-lang` is not installed, the file is damaged, packed in a way that cannot be
    read, or has no such grid.
    """
    try:
        import warp
    except ImportError as fault:
        raise InputError(
            f"{file} needs the package warp-lang to be read: install torchprt[nanovdb], or save its numbers as .npz"
        ) from fault
    entries = _entries(file)
    floats = [number for number, entry in enumerate(entries) if entry.type == _FLOAT]
    number = floats[chosen(file, [entries[each].name for each in floats], grid)]
    # It would tell what devices there are.
    warp.config.log_level = warp.LOG_ERROR
    try:
        with file.open("rb") as stream:
            volume = warp.Volume.load_from_nvdb(stream, device="cpu")
        for _ in range(number):
            volume = volume.load_next_grid()
    except Exception as fault:  # Damaged files end in exceptions of struct and zlib as well.
        if "blosc" in str(fault):
            raise InputError(f"{file} is packed with blosc: install the package blosc, or write it unpacked") from fault
        raise _broken(file) from fault
    about = volume.get_grid_info()
    low, high = _box(volume, entries[number])
    if any(first > last for first, last in zip(low, high, strict=True)):
        raise InputError(f"{file} is empty: no cell of its grid '{about.name}' is set")

    def read(first: list[int], last: list[int]) -> np.ndarray:
        shape = [end - start + 1 for start, end in zip(first, last, strict=True)]
        values = warp.empty(shape, dtype=float, device="cpu")
        warp.launch(_look(), dim=shape, inputs=[volume.id, *first, values], device="cpu")
        return values.numpy()

    linear = np.array(about.transform_matrix, np.float64).reshape(3, 3)
    return placed(file, linear, np.array(about.translation, np.float64), low, high, read)


def _entries(file: Path) -> list[_Entry]:
    """What the beginning of a file says of its grids."""
    found = []
    try:
        with file.open("rb") as stream:
            magic, _, count, _ = struct.unpack(_FILE, stream.read(struct.calcsize(_FILE)))
            if magic.to_bytes(8, "little") not in (b"NanoVDB0", b"NanoVDB2"):
                raise _broken(file)
            for _ in range(count):
                fields = struct.unpack(_GRID, stream.read(struct.calcsize(_GRID)))
                name = stream.read(fields[21]).split(b"\0")[0].decode("utf-8", "replace")
                found.append(_Entry(name, fields[4], fields[12:18]))
    except (OSError, struct.error) as fault:
        raise _broken(file) from fault
    return found


def _box(volume: Any, entry: _Entry) -> tuple[list[int], list[int]]:
    """The cells around all that is set, the highest included: what the file says, and its leaves, which writers that
    say nothing of it have."""
    low, high = list(entry.box[:3]), list(entry.box[3:])
    leaves = volume.get_tiles().numpy()
    if not any(entry.box) and len(leaves):
        low, high = leaves.min(0).tolist(), (leaves.max(0) + 7).tolist()
    return low, high


@functools.cache
def _look() -> Any:
    """The program that reads cells, which Warp compiles once and keeps."""
    import warp

    def look(volume: warp.uint64, x: int, y: int, z: int, values: warp.array3d(dtype=float)):  # type: ignore
        i, j, k = warp.tid()
        values[i, j, k] = warp.volume_lookup_f(volume, x + i, y + j, z + k)

    # The function itself, whose text Warp reads, with the types themselves.
    inner = inspect.unwrap(look)
    inner.__annotations__ = {
        "volume": warp.uint64,
        "x": int,
        "y": int,
        "z": int,
        "values": warp.array3d(dtype=float),
    }
    kernel: Callable[..., Any] = warp.kernel
    return kernel(inner)


def _broken(file: Path) -> InputError:
    return InputError(f"{file} is no whole NanoVDB file of version 32: write it again")
