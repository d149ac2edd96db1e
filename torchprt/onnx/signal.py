"""Signals in a graph: the same mathematics as those of `shade`, in the layouts that run fastest there."""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor, nn

from torchprt.shade import DenseSignal, SignalModule


class SignalGraph(nn.Module):
    """`light [B, N, 3]`, turned, to radiance `[B, 3, G]`, weight included, toward eyes whose functions are
    `values [B, M, G]` (None where there are none) in a pose of frames `[3, 3, G]` (None at rest). Vertices are last.

    As it is, it traces what a signal of `shade` computes; other signals are registered with `signal_graph.register`,
    as classes made from the module of the signal and the weight `[G or 1, 3 or 1]`. ONNX Runtime refuses a product that
    broadcasts a batch of none: put receivers first in `toward`, as `shade.dense.matrix_vectors` does.
    """

    weight: Tensor | None

    def __init__(self, signal: SignalModule | None, weight: Tensor | None) -> None:
        super().__init__()
        self.signal: Any = signal
        self.register_buffer("weight", None if weight is None else weight.detach().T.float().contiguous())

    def forward(self, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Tensor:
        turned = None if frames is None else frames.permute(2, 0, 1)
        vectors: Tensor = self.signal.toward(None if values is None else values.mT, turned)
        rows = vectors.movedim(1, -2)
        if len(rows) == 1:
            return self.weighed(light.mT @ rows[0])
        lights = by_channel(light)
        product = lights @ rows if values is None else (lights.unsqueeze(-2) @ rows).squeeze(-2)
        return self.weighed(product.transpose(0, 1))

    def shared(self, light: Tensor, values: Tensor, frames: Tensor | None, lights: int) -> Tensor:
        """The same of `light [B lights, N, 3]`, of which so many share the eye of `values [B, M, G]`."""
        repeated = values.unsqueeze(1).expand(-1, lights, -1, -1).flatten(0, 1)
        radiance: Tensor = self(light, repeated, frames)
        return radiance

    def weighed(self, radiance: Tensor) -> Tensor:
        return radiance if self.weight is None else radiance * self.weight

    def fixed(self, light: Tensor) -> nn.Module | None:
        """From `values` to radiance under one light `[N, 3]` that is inside, if that is not by stored coefficients."""
        return None


@functools.singledispatch
def signal_graph(signal: SignalModule, weight: Tensor | None) -> SignalGraph:
    """The part of a graph for a signal, by the class of its module; without a `weight` where others apply it."""
    return SignalGraph(signal, weight)


@functools.singledispatch
def arranged(signal: SignalModule) -> tuple[SignalModule, Tensor | None]:
    """The signal with its receivers in the order in which a graph holds them, and the number of the receiver at every
    place, None if each is at its own. One may stand at several."""
    return signal, None


@signal_graph.register(DenseSignal)
def _dense(signal: DenseSignal, weight: Tensor) -> SignalGraph:
    return VectorGraph(signal, weight) if signal.values.ndim == 3 else MatrixGraph(signal, weight)


class VectorGraph(SignalGraph):
    """Transfer vectors, with the weight folded in wherever that stores nothing more.

    The product streams the transfer once, which ONNX Runtime runs about twice as fast as `[V, N] @ [N, 3]`.
    """

    values: Tensor
    weight: Tensor | None

    def __init__(self, signal: DenseSignal, weight: Tensor) -> None:
        nn.Module.__init__(self)
        vectors, apart = fold(signal.values, weight)
        self.register_buffer("values", vectors[0] if len(vectors) == 1 else vectors)
        self.register_buffer("weight", apart)

    def forward(self, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Tensor:
        if self.values.ndim == 3:
            return (by_channel(light) @ self.values).transpose(0, 1)
        if self.weight is not None and self.weight.shape[1] == 1:
            light = light * self.weight.T
        count, receivers = self.values.shape
        radiance = (light.mT.reshape(-1, count) @ self.values).reshape(-1, 3, receivers)
        return radiance * self.weight if self.weight is not None and self.weight.shape[1] != 1 else radiance


class MatrixGraph(SignalGraph):
    """Transfer matrices: the light first, as one product that streams the matrices `[N, M G]` once, then a weighted sum
    over M.

    In ONNX Runtime at G = 25 000, M = N = 25, one thread: 2.8 ms for one light and eye and 27 ms for 16. The view
    first, G products `[B, M] @ [M, N]` and then the lights, takes 4.9 and 23 ms, or 6.7 and 68 as `[N, M] @ [M, B]`.
    While it runs it needs 24 M G bytes a light.
    """

    matrix: Tensor
    weight: Tensor | None

    def __init__(self, signal: DenseSignal, weight: Tensor) -> None:
        nn.Module.__init__(self)
        channels, self.receivers, self.rows, columns = signal.values.shape
        streams = signal.values.permute(0, 3, 2, 1).reshape(channels, columns * self.rows, self.receivers)
        streams, apart = fold(streams, weight)
        self.register_buffer("matrix", streams.reshape(channels, columns, self.rows * self.receivers))
        self.register_buffer("weight", apart)

    def forward(self, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Tensor:
        channels, columns, _ = self.matrix.shape
        assert values is not None
        if channels == 3:
            exits = (by_channel(light) @ self.matrix).reshape(3, -1, self.rows, self.receivers)
            return (exits * values).sum(2).movedim(0, 1)
        exits = (light.mT.reshape(-1, columns) @ self.matrix[0]).reshape(-1, 3, self.rows, self.receivers)
        radiance = (exits * values.unsqueeze(1)).sum(2)
        return self.weighed(radiance)


def by_channel(light: Tensor) -> Tensor:
    """`light [B, N, 3]` as `[3, B, N]`, for products whose batch are the channels.

    Not by a Transpose: ONNX Runtime makes one product of a Transpose that moves the first dimension and of the MatMul
    behind it, which divides by the size of that dimension. With a batch of none the process dies.
    """
    channels = light.mT
    return torch.stack([channels.select(1, channel) for channel in range(3)])


def fold(vectors: Tensor, weight: Tensor) -> tuple[Tensor, Tensor | None]:
    """`vectors [C, K, V]` times `weight [V or 1, 3 or 1]` in float32, and the weight `[3, V or 1]` if it stays apart.

    RGB weights over single-channel vectors do: folding them would store three times as much.
    """
    vectors, weight = vectors.detach(), weight.detach()
    if weight.shape[1] == 3 and len(vectors) == 1:
        return vectors.float().contiguous(), weight.T.float().contiguous()
    wide = torch.promote_types(torch.promote_types(vectors.dtype, weight.dtype), torch.float32)
    return (vectors.to(wide) * weight.T[:, None].to(wide)).float().contiguous(), None
