"""A signal number by number, in the layouts that a product reads as one stream."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import FLOATS, Layout
from torchprt.transfer.signal import Signal, check_counts, columns_of

_CHUNK = 4096


@dataclass(kw_only=True, repr=False)
class Dense(Signal):
    """What a bake records, as it is.

    `values`: transfer vectors `[C, N, G]`, receivers last, or transfer matrices `[C, G, M, N]`, receivers first. Any
    float dtype; float16 and bfloat16 are for storage.
    Raises InputError for other shapes or dtypes.
    """

    kind: ClassVar[str] = "dense"
    layouts: ClassVar[dict[str, Layout]] = {"values": Layout(("C", "N", "G"))}
    stored: ClassVar[tuple[str, ...]] = ("values",)
    approximates: ClassVar[bool] = False

    values: Tensor

    def __post_init__(self) -> None:
        if self.values.ndim == 3:
            super().__post_init__()
        elif self.values.ndim != 4 or self.values.dtype not in FLOATS:
            raise InputError(
                f"values of the transfer are {self.values.dtype} {list(self.values.shape)}: they must be floats, "
                "[C, N, G] or [C, G, M, N]"
            )
        _, channels, _, columns = self.shape
        check_counts(channels, columns)

    @property
    def shape(self) -> tuple[int, int, int, int]:
        if self.values.ndim == 3:
            channels, columns, receivers = self.values.shape
            return receivers, channels, 1, columns
        channels, receivers, rows, columns = self.values.shape
        return receivers, channels, rows, columns

    def laid_out(self, matrices: bool) -> Dense:
        """As matrices, or as vectors if there is one row: the same numbers, in the layout that a layer is of."""
        if matrices == (self.values.ndim == 4) or self.shape[2] != 1:
            return self
        values = self.values.mT.unsqueeze(2) if matrices else self.values.squeeze(2).mT
        return Dense(values=values.contiguous())

    def to_order(self, order: int) -> Dense:
        count = columns_of(order, math.isqrt(self.shape[3]))
        kept = self.values[:, :count] if self.values.ndim == 3 else self.values[..., :count]
        return Dense(values=kept.contiguous())

    def take(self, index: Int[Tensor, "g"]) -> Dense:
        return Dense(values=self.values.index_select(2 if self.values.ndim == 3 else 1, index).contiguous())

    def dense(self) -> Dense:
        return self.to(torch.promote_types(self.dtype, torch.float32))

    def combined(self, rows: Float[Tensor, "R M"]) -> Dense:
        channels, receivers, _, columns = self.values.shape
        made = self.values.new_empty(channels, receivers, len(rows), columns)
        for start in range(0, receivers, _CHUNK):
            part = slice(start, start + _CHUNK)
            made[:, part] = (rows @ self.values[:, part].double()).to(made.dtype)
        return Dense(values=made)
