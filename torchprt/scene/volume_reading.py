"""Volumes from files: arrays of numpy, and grids of OpenVDB and NanoVDB."""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchprt.errors import InputError
from torchprt.suffixes import VOLUMES, by_content, check_readable, refuse_other
from torchprt.words import either

from .material import Numbers
from .volume import Volume
from .volume_grid import Grid

_NAMES = ("extinction", "density", "albedo", "origin", "spacing", "phase")


def read_volume(
    path: str | os.PathLike[str],
    *,
    scale: float | int = 1.0,
    albedo: Numbers | None = None,
    phase: float | int | Sequence[float | int] | None = None,
    spacing: float | int | Sequence[float | int] | None = None,
    origin: Sequence[float | int] | None = None,
    coarsen: int = 1,
    grid: str | None = None,
) -> Volume:
    """The volume in a file, without the empty cells around what it holds.

    - `.npy`: density [X, Y, Z], or [X, Y, Z, 2 or 4] with one or three numbers of albedo behind it.
    - `.npz`: arrays by name, `extinction` or `density` [X, Y, Z], and if wanted `albedo` (one number, three, or
      [X, Y, Z, 1 or 3]), `origin`, `spacing` and `phase`, all as `Volume` takes them.
    - `.nvdb` (by `warp-lang`, of the extra `nanovdb`) and `.vdb` (by the module `openvdb`, which comes with conda's
      package of that name and with Blender): a grid of floats, the one named `grid` if the file has several, where the
      file places it; axes may be exchanged, not turned otherwise.

    `scale` times the density is extinction, a unit of the world's length. `coarsen` takes the mean of so many cells
    along each axis (of albedo by what they extinguish) while it reads. `albedo` (1 where nothing says it), `phase`
    (0), `spacing` (1) and `origin` (0) stand in place of what the file says; `origin` is the lowest corner of the grid
    in the file, `spacing` the size of one of its cells.

    Raises InputError if the file cannot be read, holds another kind of thing, needs a package that is not installed,
    would not fit into memory, or holds what `Volume` refuses.
    """
    file = check_readable(path)
    if file.suffix.lower() not in VOLUMES:
        refuse_other(file, "a volume")
        raise InputError(f"{file} is not a volume: give a file that ends in {either(VOLUMES)}")
    if not 0 < scale < math.inf:
        raise InputError(f"scale of {file} is {scale:g}: give a number above 0")
    if coarsen < 1:
        raise InputError(f"coarsen of {file} is {coarsen}: give a number from 1")
    found = _READERS[file.suffix.lower()](file, grid)
    _check_fits(file, found, coarsen)
    density, of_cells = _coarse(file, found, coarsen)
    inside = [np.nonzero(density.any(axis=tuple(other for other in range(3) if other != axis)))[0] for axis in range(3)]
    if not len(inside[0]):
        raise InputError(f"{file} is empty: its density is 0 everywhere")
    box = tuple(slice(int(along[0]), int(along[-1]) + 1) for along in inside)
    size = _three(file, found.spacing if spacing is None else spacing, "spacing", 1.0) * coarsen
    corner = _three(file, found.origin if origin is None else origin, "origin", 0.0)
    chosen: Any = albedo if albedo is not None else of_cells[box] if of_cells is not None else found.albedo
    return Volume(
        density[box] * np.float32(scale),
        torch.tensor(chosen, dtype=torch.float32)
        if isinstance(chosen, np.ndarray)
        else 1.0
        if chosen is None
        else chosen,
        origin=tuple(float(low) for low in corner + [along.start for along in box] * size),
        spacing=tuple(float(each) for each in size),
        phase=next((each for each in (phase, found.phase) if each is not None), 0.0),
        name=str(file),
    )


def _check_fits(file: Path, found: Grid, coarsen: int) -> None:
    """InputError if what is kept of the grid needs more memory than the machine has; nothing large is there yet."""
    if len(found.shape) != 3 or 0 in found.shape:
        raise InputError(f"{file} has density of shape {list(found.shape)}: give [X, Y, Z], one cell or more a side")
    cells = math.prod(-(-count // coarsen) for count in found.shape)
    # Density and its copy in the box, which cells are filled, albedo and its copy; a few sheets of the file.
    bytes_of = 9 * cells + 8 * found.channels * cells + 8 * (1 + found.channels) * coarsen * math.prod(found.shape[1:])
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if bytes_of > memory:
        raise InputError(
            f"{file} has {' x '.join(map(str, found.shape))} cells, which take {bytes_of / 2**30:.0f} GB of the "
            f"{memory / 2**30:.0f} that there are: coarsen it"
        )


def _coarse(file: Path, found: Grid, coarsen: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Density `[X, Y, Z]` in float32 and what albedo the cells have, the means of blocks of cells."""
    shape = tuple(-(-count // coarsen) for count in found.shape)
    density = np.zeros(shape, np.float32)
    albedo = np.zeros((*shape, found.channels), np.float32) if found.channels else None
    for row in range(shape[0]):
        here, shown = found.sheets(row * coarsen, min((row + 1) * coarsen, found.shape[0]))
        with np.errstate(over="ignore"):
            here = np.asarray(here, np.float64 if coarsen > 1 else np.float32)
        bad = int((~np.isfinite(here)).sum())
        if bad:
            raise InputError(f"{file} has cells whose density is NaN or infinite: give finite numbers")
        if here.min(initial=0) < 0:
            raise InputError(f"{file} has density down to {here.min():g}: give one of 0 or more, no signed distance")
        density[row] = _mean(here, coarsen)
        if albedo is not None and shown is not None:
            shown = np.asarray(shown, np.float32)
            _check_albedo(file, shown[here > 0])
            weighted = np.moveaxis(_mean(np.moveaxis(shown * here[..., None], -1, 0), coarsen), 0, -1)
            albedo[row] = np.clip(weighted / np.maximum(density[row], np.finfo(np.float32).tiny)[..., None], 0, 1)
    return density, albedo


def _check_albedo(file: Path, shown: np.ndarray) -> None:
    # Written so that NaN is refused too.
    if not ((shown >= 0) & (shown <= 1)).all():
        raise InputError(f"albedo of {file} ranges from {shown.min():g} to {shown.max():g}: give values in [0, 1]")


def _mean(sheets: np.ndarray, coarsen: int) -> np.ndarray:
    """`[*, x, Y, Z]` of up to `coarsen` sheets to `[*, Y / coarsen, Z / coarsen]`, as if there were more that are 0."""
    if coarsen == 1:
        return sheets[..., 0, :, :]
    *_, rows, columns = sheets.shape
    pad = [(0, 0)] * (sheets.ndim - 2) + [(0, -rows % coarsen), (0, -columns % coarsen)]
    sums = np.pad(sheets, pad).sum(-3)
    blocks = sums.reshape(*sums.shape[:-2], sums.shape[-2] // coarsen, coarsen, sums.shape[-1] // coarsen, coarsen)
    return blocks.sum((-3, -1)) / coarsen**3


def _three(file: Path, values: Any, what: str, otherwise: float) -> np.ndarray:
    try:
        numbers = np.broadcast_to(np.asarray(otherwise if values is None else values, np.float64), 3)
    except (TypeError, ValueError) as fault:
        raise InputError(f"{what} of {file} is {values}: give one number, or three") from fault
    return numbers.copy()


def _npy(file: Path, grid: str | None) -> Grid:
    _no_name(file, grid)
    try:
        with file.open("rb") as stream:
            shape, dtype = _header(stream)
            whole = np.prod(shape, dtype=object) * dtype.itemsize + stream.tell() <= file.stat().st_size
    except Exception as fault:  # Damaged headers end in exceptions of any kind.
        raise _broken(file) from fault
    if dtype.kind not in "fiu":
        raise _broken(file)
    if len(shape) == 4 and shape[3] not in (2, 4):
        raise InputError(
            f"{file} has shape {list(shape)}: give density [X, Y, Z], or [X, Y, Z, 2 or 4] with albedo behind it"
        )
    channels = shape[3] - 1 if len(shape) == 4 else 0

    def sheets(start: int, stop: int) -> tuple[np.ndarray, np.ndarray | None]:
        if not whole:
            raise _broken(file)
        some = np.load(file, mmap_mode="r", allow_pickle=False)[start:stop]
        return (some[..., 0], some[..., 1:]) if channels else (some, None)

    return Grid(shape[:3], sheets, channels)


def _npz(file: Path, grid: str | None) -> Grid:
    _no_name(file, grid)
    try:
        with zipfile.ZipFile(file) as archive:
            headers = {}
            for name in archive.namelist():
                with archive.open(name) as stream:
                    headers[name.removesuffix(".npy")] = _header(stream)
    except Exception as fault:  # Damaged headers end in exceptions of any kind.
        raise _broken(file) from fault
    strange = [name for name in headers if name not in _NAMES]
    density = [name for name in _NAMES[:2] if name in headers]
    if len(density) != 1 or strange:
        raise InputError(
            f"{file} holds {', '.join(headers) or 'nothing'}: give extinction or density, and if "
            "wanted albedo, origin, spacing and phase"
        )
    if any(dtype.kind not in "fiu" for _, dtype in headers.values()):
        raise _broken(file)
    shape, _ = headers[density[0]]
    shown, _ = headers.get("albedo", ((), None))
    a_cell = len(shown) == 4
    if a_cell and (shown[:3] != shape or shown[3] not in (1, 3)):
        raise InputError(
            f"albedo of {file} has shape {list(shown)} for density of {list(shape)}: give [X, Y, Z, 1 or 3]"
        )
    loaded: dict[str, np.ndarray] = {}

    def load(name: str) -> np.ndarray:
        if name not in loaded:
            try:
                with np.load(file, allow_pickle=False) as arrays:
                    loaded[name] = arrays[name]
            except Exception as fault:
                raise _broken(file) from fault
        return loaded[name]

    def sheets(start: int, stop: int) -> tuple[np.ndarray, np.ndarray | None]:
        return load(density[0])[start:stop], load("albedo")[start:stop] if a_cell else None

    few = {name: load(name).astype(np.float64).tolist() for name in ("origin", "spacing", "phase") if name in headers}
    albedo = load("albedo") if "albedo" in headers and not a_cell else None
    return Grid(shape, sheets, shown[3] if a_cell else 0, albedo, **few)


def _header(stream: Any) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and type of an array that is about to be read."""
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return shape, dtype


def _broken(file: Path) -> InputError:
    seen = by_content(file)
    # A zip of numpy has no beginning of its own.
    if seen is not None and seen[0] != file.suffix.lower():
        return InputError(f"{file} is {seen[1]}, not a volume: give it the suffix {seen[0]}")
    return InputError(f"{file} is not a whole {file.suffix.lower()} file of numbers: write it again")


def _no_name(file: Path, grid: str | None) -> None:
    if grid is not None:
        raise InputError(
            f"the grid '{grid}' of {file} is asked for, but such files have no names of grids: leave it out"
        )


def _nvdb(file: Path, grid: str | None) -> Grid:
    from .volume_nanovdb import read_nanovdb

    return read_nanovdb(file, grid)


def _vdb(file: Path, grid: str | None) -> Grid:
    from .volume_openvdb import read_openvdb

    return read_openvdb(file, grid)


_READERS: dict[str, Callable[[Path, str | None], Grid]] = {".npy": _npy, ".npz": _npz, ".nvdb": _nvdb, ".vdb": _vdb}
