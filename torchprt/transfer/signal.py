"""How the numbers of a layer are stored: a linear map from light, a few numbers a receiver."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import Part, bytes_of

if TYPE_CHECKING:
    from torchprt.transfer.dense import Dense

S = TypeVar("S", bound="Signal")


@dataclass(kw_only=True, repr=False)
class Signal(Part, abc.ABC):
    """The transfer matrices `[C, M, N]` of G receivers, M = 1 for transfer vectors.

    C is 1 unless light bounced off coloured surfaces, then 3. N are coefficients of the light, or of whatever the layer
    says that they are. `stored`: the tensors of numbers, most of the bytes first, which may be of any float dtype.
    `approximates`: it is what compression made, and is not compressed again. `follows_pose`: it turns with a surface
    that deforms.
    """

    family: ClassVar[dict[str, type[Any]]] = {}
    stored: ClassVar[tuple[str, ...]]
    approximates: ClassVar[bool] = True
    follows_pose: ClassVar[bool] = False

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, int, int, int]:
        """G, C, M, N."""

    @property
    def dtype(self) -> torch.dtype:
        """Of the numbers."""
        value: Tensor = getattr(self, self.stored[0])
        return value.dtype

    @property
    def bytes(self) -> int:
        """Bytes of what is stored, but for what is told of errors."""
        return bytes_of(*(value for name, value in self.tensors().items() if name != "squared_error"))

    def to(self: S, dtype: torch.dtype) -> S:
        """The same stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        return self.replace(**{name: getattr(self, name).to(dtype) for name in self.stored})

    @abc.abstractmethod
    def to_order(self: S, order: int) -> S:
        """For lights of the first `order` bands; InputError if it does not have them."""

    @abc.abstractmethod
    def take(self: S, index: Int[Tensor, "g"]) -> S:
        """Of the receivers that `index` names, in its order."""

    def dense(self) -> Dense:
        """The same number by number, in float32 or float64. Raises InputError for a signal that has no such form."""
        raise InputError(f"a {self.kind} signal cannot be written out number by number here: shade it")

    def combined(self: S, rows: Float[Tensor, "R M"]) -> S:
        """`rows @ matrix` for every receiver, in float64. Raises InputError if it cannot be stored in the same way."""
        raise InputError(f"the rows of a {self.kind} signal cannot be combined: combine them first, then compress")


def check_counts(channels: int, columns: int) -> None:
    """InputError unless there are 1 or 3 channels and the square of an order of coefficients."""
    if channels not in (1, 3):
        raise InputError(f"transfer has {channels} channels: it must have 1 or 3")
    if math.isqrt(columns) ** 2 != columns or columns == 0:
        raise InputError(f"transfer has {columns} coefficients a vertex: it must be the square of the order")


def columns_of(order: int, available: int, least: int = 1) -> int:
    """The square of `order`; InputError unless it is one of `least` to `available`."""
    if not least <= order <= available:
        raise InputError(f"order {order} is not between {least} and the {available} that the transfer has")
    return order * order
