"""A file that a bake writes in place of a result in memory."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from torchprt.files import check_writable
from torchprt.transfer import Transfer, load, save


@dataclass(frozen=True)
class Output:
    """The `.safetensors` that a bake writes part by part: its `path`, the `dtype` that transfer is stored as (that of
    the bake, float32, by default), and what is made of the transfer before it is written, `then`, whose large tensors
    are maps of files and must not be copied whole.

    Raises InputError if `path` is no place for such a file.
    """

    path: str | os.PathLike[str]
    dtype: torch.dtype | None = None
    then: Callable[[Transfer], Transfer] | None = None

    def __post_init__(self) -> None:
        check_writable(self.path, (".safetensors",))

    @property
    def partial(self) -> Path:
        """The folder that keeps finished chunks, unless another is named."""
        path = Path(self.path)
        return path.with_name(path.name + ".partial")

    def written(self, transfer: Transfer) -> Transfer:
        """The transfer as it is in the file, whose tensors are maps of it."""
        save(transfer if self.then is None else self.then(transfer), self.path, dtype=self.dtype)
        # What was checked as it was written need not be read for that again.
        return load(self.path, mapped=True, numbers=False)


def output_of(out: str | os.PathLike[str] | Output | None) -> Output | None:
    """What the argument `out` of a bake says."""
    return out if out is None or isinstance(out, Output) else Output(out)
