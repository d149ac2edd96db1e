"""Where the large tables of a bake stand: in memory, or in files on disk that are mapped into it."""

from __future__ import annotations

import errno
import math
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.files import sentences
from torchprt.transfer.pieces import rows

_ZEROS = 1 << 24


@runtime_checkable
class Tables(Protocol):
    """What makes tensors of a row a receiver. Whoever fills them walks over their rows, so that no more than some rows
    are copied at a time, and gives the same bits wherever they stand."""

    def empty(self, *shape: int) -> Tensor:
        """A float32 tensor, contiguous, of any values."""

    def laid_out(self, values: Tensor) -> Tensor:
        """A view of a table in the order of a signal, as a transfer holds it."""


class InMemory:
    """Tables in memory, signals in the layout that shades fast."""

    def empty(self, *shape: int) -> Tensor:
        """As `Tables.empty`."""
        return torch.empty(shape)

    def laid_out(self, values: Tensor) -> Tensor:
        """As `Tables.laid_out`: a copy, unless it lies so."""
        return values.contiguous()


@dataclass(frozen=True)
class Mapped:
    """Tables in files without a name beside the `result` that they are for: they are gone when their tensor is, or the
    process.

    Their room is taken when they are made: a page that found no room later would end the process.
    Raises CannotWrite, of the result, if there is none.
    """

    result: Path

    def empty(self, *shape: int) -> Tensor:
        """As `Tables.empty`."""
        size = 4 * math.prod(shape)
        if not size:
            return torch.empty(shape)
        with sentences(self.result), tempfile.TemporaryFile(dir=self.result.absolute().parent) as file:
            _allocate(file, size)
            # The map keeps the file when it is closed.
            return torch.from_numpy(np.memmap(file, np.float32, "r+", shape=shape))

    def laid_out(self, values: Tensor) -> Tensor:
        """As `Tables.laid_out`: the view itself, which `transfer.save` puts in order as it writes it."""
        return values


def _allocate(file: BinaryIO, size: int) -> None:
    """Makes a file so large, with room for all of it."""
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(file.fileno(), 0, size)
            return
        except OSError as fault:
            if fault.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS):
                raise
    zeros = bytes(_ZEROS)
    for start in range(0, size, _ZEROS):
        file.write(zeros[: size - start])
    file.flush()


def in_channels(table: Float[Tensor, "*V W"], times: int, tables: Tables) -> Float[Tensor, "*V D"]:
    """A table with its columns so many times side by side: itself for once."""
    if times == 1:
        return table
    found = tables.empty(*table.shape[:-1], times * table.shape[-1])
    flat, wide = table.flatten(0, -2), found.view(-1, found.shape[-1])
    for some in rows(len(flat), wide.shape[1]):
        wide[some] = flat[some].repeat(1, times)
    return found


def any_of(table: Tensor) -> bool:
    """Whether anything in a table is not zero."""
    flat = table.flatten(1)
    return any(bool(flat[some].any()) for some in rows(len(flat), flat.shape[1]))


def channels_first(table: Float[Tensor, "V W"], columns: int, tables: Tables) -> Float[Tensor, "C N V"]:
    """Vectors of N `columns` a channel with receivers first as a signal has them."""
    return tables.laid_out(table.view(len(table), -1, columns).permute(1, 2, 0))
