"""Transfer number by number at run time: the eye first, then every further light costs what a diffuse one does."""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.shade.batches import light_product, receivers_of
from torchprt.shade.signal import Making, SignalModule, hold, signal_module
from torchprt.transfer import Dense


@signal_module.register(Dense)
class DenseSignal(SignalModule):
    """A buffer `values`, transfer vectors `[C, N, G]` or matrices `[C, G, M, N]`; `learn` may name it.

    Half precision is widened to the dtype of the shader when it is made; otherwise the buffer shares the memory of the
    stored signal, so what is written into one is written into both. Parameters are copies.
    Source: Sloan, Kautz and Snyder 2002, section 6, equation 8.
    """

    learnable = ("values",)
    values: Tensor

    def __init__(self, signal: Dense, making: Making, lost: Tensor | None = None):
        super().__init__(signal.shape)
        values = signal.values
        if lost is not None:
            values = values.index_fill(2 if values.ndim == 3 else 1, lost, 0)
        hold(self, "values", values, making)

    @classmethod
    def holding(cls, values: Tensor) -> DenseSignal:
        """Of a tensor as it is, through which gradients may flow."""
        made = cls.__new__(cls)
        SignalModule.__init__(made, Dense(values=values).shape)
        made.register_buffer("values", values)
        return made

    def under(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        if self.values.ndim == 3:
            return light_product(light, self.values).unsqueeze(-2)
        channels, receivers, rows, columns = self.values.shape
        batch = light.shape[:-2]
        lights = light.mT.movedim(-2, 0).reshape(channels, 3 // channels * math.prod(batch), columns)
        flat = torch.bmm(lights, self.values.view(channels, receivers * rows, columns).mT)
        return flat.view(3, *batch, receivers, rows).movedim(0, -3).mT.contiguous()

    def toward(self, values: Tensor | None, frames: Tensor | None = None) -> Float[Tensor, "C N ..."]:
        return self.values if values is None else matrix_vectors(self.values, values)

    def applied_in_pieces(self, rows: Float[Tensor, "K N"], size: int) -> Iterator[Float[Tensor, "K g"]]:
        for piece in self.toward(None)[0].split(size, 1):
            yield rows @ piece

    def part(self, first: int, last: int, receivers: Tensor | None = None) -> DenseSignal:
        columns = slice(first * first, last * last)
        values = self.values[:, columns] if self.values.ndim == 3 else self.values[..., columns]
        if receivers is not None:
            values = receivers_of(values, receivers) if values.ndim == 3 else values.index_select(1, receivers)
        made = DenseSignal.__new__(DenseSignal)
        count = values.shape[2] if values.ndim == 3 else values.shape[1]
        SignalModule.__init__(made, (count, *self.shape[1:3], last * last - first * first))
        made.register_buffer("values", values)
        return made


def matrix_vectors(matrix: Float[Tensor, "C G M N"], values: Float[Tensor, "*B G M"]) -> Float[Tensor, "C N ..."]:
    """`sum_i values_i matrix_ij`: one product a receiver, which reads the matrices once for all eyes."""
    channels, receivers, rows, columns = matrix.shape
    eyes = values.shape[:-2]
    count, pairs = math.prod(eyes), channels * receivers
    # Copied in this order: a product of strided exit values is ten times slower.
    left = values.reshape(count, receivers, rows).transpose(0, 1).contiguous()
    left = left.expand(channels, receivers, count, rows).reshape(pairs, count, rows)
    flat = torch.bmm(left, matrix.reshape(pairs, rows, columns))
    return flat.view(channels, receivers, *eyes, columns).movedim((-1, 1), (1, -1))
