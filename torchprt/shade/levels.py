"""A layer at a lower order of the light, for some of its receivers: what adaptive shading adds up level by level."""

from __future__ import annotations

import abc
import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.shade.batches import receivers_of

if TYPE_CHECKING:
    from torchprt.shade.layer import LayerModule


@runtime_checkable
class Level(Protocol):
    """A layer at some order, under a light: what does not depend on the receivers was made once."""

    def __call__(self, receivers: Tensor | None = None, below: tuple[int, Tensor] | None = None) -> Tensor:
        """Radiance `[*B, 3, g]` of `receivers [g]`, all if None, without the weight.

        `below`: a lower level and the radiance of these receivers there, which may spare some of the work.
        """


class Levels(abc.ABC):
    """The radiance of a layer at rising `orders` of the light, the last of which is its own.

    What order means beside that is the layer's matter: a product of visibility and light truncates both. Made by
    `LayerModule.levels`.
    """

    def __init__(self, layer: LayerModule, orders: Sequence[int]):
        self.layer, self.orders = layer, tuple(orders)

    @abc.abstractmethod
    def at(
        self,
        level: int,
        light: Float[Tensor, "*#B N 3"],
        values: Float[Tensor, "*#B G M"] | None,
        frames: Float[Tensor, "*#B G 3 3"] | None,
    ) -> Level:
        """What shades receivers at `orders[level]`, under a light, toward the eyes of `values`, in poses.

        `light`, `values` and `frames` are those of the whole layer.
        """

    @abc.abstractmethod
    def multiplications(self, level: int, below: int | None) -> int:
        """Of one receiver, under one light, toward one eye, as `at` makes them."""


class LinearLevels(Levels):
    """Of a layer whose signal meets the light: the products with the bands that a level adds.

    Raises InputError if a receiver costs the same at any order.
    """

    def __init__(self, layer: LayerModule, orders: Sequence[int]):
        super().__init__(layer, orders)
        if not layer.signal.costs_by_order:
            raise InputError(
                f"adaptive shading saves nothing with {type(layer.signal).__name__}, where a receiver costs the same "
                "at any order of the light: call the shader itself, or give None as the threshold of that layer"
            )

    def at(self, level: int, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Level:
        last, signal = self.orders[level], self.layer.signal

        def shaded(receivers: Tensor | None = None, below: tuple[int, Tensor] | None = None) -> Tensor:
            first = 0 if below is None else self.orders[below[0]]
            seen, posed = values, frames
            if receivers is not None:
                seen = None if seen is None else receivers_of(seen.mT, receivers).mT
                posed = None if posed is None else posed.index_select(-3, receivers)
            added = signal.part(first, last, receivers).radiance(
                light[..., first * first : last * last, :], seen, posed
            )
            return added if below is None else below[1] + added

        return shaded

    def multiplications(self, level: int, below: int | None) -> int:
        first, last = 0 if below is None else self.orders[below], self.orders[level]
        _, channels, rows, _ = self.layer.signal.shape
        columns = last * last - first * first
        return columns * (3 if rows == 1 else channels * rows + 3)


def default_orders(order: int) -> tuple[int, ...]:
    """3, every second order above it, and `order`."""
    return (*range(min(3, order), order, 2), order)


def check_orders(orders: Sequence[int], order: int) -> tuple[int, ...]:
    """InputError unless `orders` rise from 1 or more to `order`."""
    whole = [int(each) for each in orders]
    rising = all(low < high for low, high in itertools.pairwise(whole))
    if not whole or whole != list(orders) or whole[0] < 1 or whole[-1] != order or not rising:
        raise InputError(
            f"levels are {list(orders)}: they must rise from an order of 1 or more to {order}, the shader's"
        )
    return tuple(whole)
