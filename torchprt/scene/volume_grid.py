"""A grid of a volume as a file holds it, before it is read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from torchprt.errors import InputError


@dataclass(frozen=True)
class Grid:
    """What a file says of its grid, None where it does not say it.

    `sheets(start, stop)` reads the density `[x, Y, Z]` of a few sheets of x, and the albedo `[x, Y, Z, 1 or 3]` or
    None: files may be larger than memory.
    """

    shape: tuple[int, ...]
    sheets: Callable[[int, int], tuple[np.ndarray, np.ndarray | None]]
    channels: int = 0
    """Of the albedo a cell, 0 if there is none."""
    albedo: np.ndarray | None = None
    """Of all cells."""
    origin: Sequence[float] | None = None
    spacing: float | Sequence[float] | None = None
    phase: float | Sequence[float] | None = None


def placed(
    file: Path,
    linear: Float[np.ndarray, "3 3"],
    shift: Float[np.ndarray, "3"],
    low: Sequence[int],
    high: Sequence[int],
    read: Callable[[list[int], list[int]], np.ndarray],
) -> Grid:
    """The grid of cells `low` to `high`, both included, whose middles stand at `linear @ (i, j, k) + shift`.

    `read(low, high)` gives the density of a part of it. Raises InputError if it is turned by other than right angles.
    """
    large = np.abs(linear) > 1e-5 * np.abs(linear).max()
    if not (large.sum(0) == 1).all() or not (large.sum(1) == 1).all():
        raise InputError(f"{file} has a grid that is turned or sheared: resample it along the axes of the world")
    # Which of i, j and k runs along x, y and z, and by what step.
    of_axis = large.argmax(1)
    step = linear[range(3), of_axis]
    size = np.abs(step)
    corners = np.stack([np.array(low) - 0.5, np.array(high) + 0.5]) @ linear.T + shift
    shape = tuple(int(high[axis] - low[axis] + 1) for axis in of_axis)

    def sheets(start: int, stop: int) -> tuple[np.ndarray, None]:
        first, last, along = list(low), list(high), int(of_axis[0])
        first[along], last[along] = low[along] + start, low[along] + stop - 1
        if step[0] < 0:
            first[along], last[along] = high[along] - stop + 1, high[along] - start
        some = read(first, last).transpose(of_axis)
        return np.flip(some, tuple(axis for axis in range(3) if step[axis] < 0)), None

    return Grid(shape, sheets, origin=corners.min(0).tolist(), spacing=size.tolist())


def chosen(file: Path, names: Sequence[str], grid: str | None) -> int:
    """Which of the grids of these names is read: the one asked for, the only one, or the first called density.

    Raises InputError if there is none, or more than one could be meant.
    """
    told = ", ".join(f"'{name}'" for name in names)
    if grid is not None:
        if grid not in names:
            raise InputError(f"{file} has no grid of floats '{grid}': it has {told or 'none'}")
        return list(names).index(grid)
    if len(names) == 1:
        return 0
    if "density" not in names:
        raise InputError(
            f"{file} has the grids of floats {told}: say which one" if names else f"{file} has no grid of floats"
        )
    return list(names).index("density")
