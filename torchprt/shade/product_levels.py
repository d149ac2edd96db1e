"""Visibility times light at some order, at the nodes of a rule that is no larger than that order needs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import basis, gauss_legendre_hemisphere, hemisphere_basis, hemisphere_nodes
from torchprt.sh.turned_product import euler_turns
from torchprt.shade.levels import Level, Levels
from torchprt.shade.signal import SignalModule

if TYPE_CHECKING:
    from torchprt.shade.visibility import VisibilityLayer

# Nodes of receivers whose products are in the cache at a time: half the time of all at once at order 11.
PIECE = 1 << 18


class Rule(NamedTuple):
    """Where visibility of I functions meets light of N coefficients and a kernel of M rows, at D nodes."""

    kernel: Float[Tensor, "M D"]
    functions: Float[Tensor, "D I"]
    harmonics: Float[Tensor, "D N"]


def local_products(
    values: Float[Tensor, "*B M g"], signal: SignalModule, rule: Rule
) -> Iterator[Float[Tensor, "*B N p"]]:
    """Transfer vectors in the local frames of some receivers, piece after piece, so that what lies between stays in the
    cache. A graph that is traced takes all at once."""
    count = values.shape[-1]
    size = max(PIECE // (max(math.prod(values.shape[:-2]), 1) * len(rule.functions)), 64)
    size = max(count, 1) if torch.compiler.is_compiling() else size
    kernel, harmonics = rule.kernel.mT, rule.harmonics.mT
    seen = signal.applied_in_pieces(rule.functions, size)
    for some, visible in zip(values.split(size, -1), seen, strict=True):
        yield harmonics @ ((kernel @ some) * visible)


class ProductLevels(Levels):
    """Of visibility: both it and the light are truncated to the order of a level, and the kernel stays as it is.

    The product of two such functions is a polynomial of the hemisphere of degree 2 n - 2, which its values at
    (2 n - 1)^2 nodes tell (`sh.hemisphere_nodes`). To these the kernel is carried over: `kernel_n = kernel B fit`, B
    the functions of that degree at the nodes of the layer. That is exact, and 25 nodes do at order 3, 441 at order 11,
    where the layer has 630 (M = 64): a receiver takes 135 000 multiplications instead of 193 000, at order 7 a fifth of
    that, at order 3 a 66th.
    Source: Sloan, Kautz and Snyder 2002, section 4.2; for levels of products the paper on locally adaptive products,
    section 4.3, which extends one product of global coefficients instead.
    """

    layer: VisibilityLayer

    def __init__(self, layer: VisibilityLayer, orders: Sequence[int]):
        super().__init__(layer, orders)
        with torch.no_grad():
            self.turns = euler_turns(layer.frames.transpose(0, 1))
        nodes = layer.functions.shape[0]
        self.carried: list[tuple[Tensor, Tensor, Tensor] | None] = []
        for order in self.orders:
            seen = min(order, math.isqrt(layer.functions.shape[1]))
            degree = seen + order - 2
            if (degree + 1) ** 2 >= nodes:
                self.carried.append(None)
                continue
            small, fit = hemisphere_nodes(degree)
            whole, _ = gauss_legendre_hemisphere(layer.degree)
            onto = hemisphere_basis(whole, degree + 1) @ fit
            tables = (onto, hemisphere_basis(small, seen), basis(small, order))
            self.carried.append(tuple(table.to(layer.functions).contiguous() for table in tables))  # type: ignore[arg-type]

    def rule(self, level: int) -> Rule:
        order, carried, layer = self.orders[level], self.carried[level], self.layer
        if carried is None:
            seen = min(order * order, layer.functions.shape[1])
            return Rule(layer.kernel, layer.functions[:, :seen], layer.harmonics[:, : order * order])
        onto, functions, harmonics = carried
        return Rule(layer.kernel @ onto, functions, harmonics)

    def at(self, level: int, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Level:
        assert values is not None
        # Once for all receivers that will be asked for.
        rule, order = self.rule(level), self.orders[level]
        shaded = self.layer.products(light[..., : order * order, :], values, rule, self.turns)

        def at(receivers: Tensor | None = None, below: tuple[int, Tensor] | None = None) -> Tensor:
            return shaded(receivers)

        return at

    def multiplications(self, level: int, below: int | None) -> int:
        rule = self.rule(level)
        rows, nodes = rule.kernel.shape
        return nodes * (rows + rule.functions.shape[1] + rule.harmonics.shape[1]) + 3 * rule.harmonics.shape[1]
