"""OpenVDB: grids of floats, by its own Python module."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from torchprt.errors import InputError

from .volume_grid import Grid, chosen, placed


def read_openvdb(file: Path, grid: str | None) -> Grid:
    """The grid of floats in a `.vdb` file, as `read_volume` says.

    Raises InputError if the module `openvdb` is not installed, the file is damaged, or it has no such grid.
    """
    vdb = _module(file)
    try:
        about = vdb.readAllGridMetadata(str(file))
        names = [each.name for each in about if each.valueTypeName in ("float", "half", "double")]
    except Exception as fault:  # Whatever the module makes of a damaged file.
        raise _broken(file) from fault
    name = names[chosen(file, names, grid)]
    try:
        found = vdb.read(str(file), name)
    except Exception as fault:
        raise _broken(file) from fault
    if found.empty() or not found.activeVoxelCount():
        raise InputError(f"{file} is empty: no cell of its grid '{name}' is set")
    if not found.transform.isLinear:
        raise InputError(f"{file} has a grid in perspective: resample it along the axes of the world")
    low, high = (list(corner) for corner in found.evalActiveVoxelBoundingBox())
    place = [np.array(found.transform.indexToWorld(tuple(map(float, at)))) for at in (np.zeros(3), *np.eye(3))]
    linear = np.stack([each - place[0] for each in place[1:]], 1)

    def read(first: list[int], last: list[int]) -> np.ndarray:
        values = np.empty([end - start + 1 for start, end in zip(first, last, strict=True)], np.float32)
        found.copyToArray(values, ijk=tuple(first))
        return values

    return placed(file, linear, place[0], low, high, read)


def _module(file: Path) -> Any:
    """OpenVDB's module, under the names that it has had; Blender's package knows where its own is."""
    for name in ("openvdb", "pyopenvdb", "bpy"):
        try:
            found = importlib.import_module(name)
            return importlib.import_module("openvdb") if name == "bpy" else found
        except ImportError:
            continue
    raise InputError(
        f"{file} needs the module openvdb to be read, which conda and Blender have: install it, or write the grid as "
        ".nvdb or its numbers as .npz"
    )


def _broken(file: Path) -> InputError:
    return InputError(f"{file} is no whole OpenVDB file: write it again")
