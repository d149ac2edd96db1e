"""A tensor a piece at a time, in the order in which its numbers lie: for what may be larger than memory."""

from __future__ import annotations

import math
from collections.abc import Iterator

from torch import Tensor

NUMBERS = 1 << 22
"""Numbers that are looked at together: 16 MB of float32, and copies of them."""


def pieces(value: Tensor, numbers: int | None = None) -> Iterator[tuple[slice, ...]]:
    """Indices of pieces of at most `numbers` that together are the whole of `value`, each number in one.

    It is cut along the axis on which neighbours are furthest apart, so that a file that is mapped into memory is read
    once, from its beginning to its end, whatever the order of the axes. `numbers`: `NUMBERS` unless given.
    """
    return _cut(value, tuple(slice(0, size) for size in value.shape), NUMBERS if numbers is None else numbers)


def _cut(value: Tensor, whole: tuple[slice, ...], numbers: int) -> Iterator[tuple[slice, ...]]:
    sizes = [part.stop - part.start for part in whole]
    count = math.prod(sizes)
    if count <= max(numbers, 1):
        if count:
            yield whole
        return
    axis = max((axis for axis, size in enumerate(sizes) if size > 1), key=value.stride)
    step = max(1, sizes[axis] * numbers // count)
    for start in range(whole[axis].start, whole[axis].stop, step):
        part = slice(start, min(start + step, whole[axis].stop))
        yield from _cut(value, (*whole[:axis], part, *whole[axis + 1 :]), numbers)


def rows(count: int, width: int) -> Iterator[slice]:
    """Slices of `count` rows of `width` numbers, about `NUMBERS` a slice and one row at least."""
    step = max(1, NUMBERS // max(1, width))
    return (slice(start, min(start + step, count)) for start in range(0, count, step))
