"""Clustered transfer at run time: lights meet representatives, receivers only weigh them."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchprt.errors import InputError
from torchprt.sh.derivatives import with_all_derivatives
from torchprt.sh.shapes import broadcast_shapes
from torchprt.shade.batches import is_one
from torchprt.shade.dense import matrix_vectors
from torchprt.shade.signal import Making, SignalModule, hold, signal_module
from torchprt.transfer import Clustered


@signal_module.register(Clustered)
class ClusteredSignal(SignalModule):
    """Clustered transfer, never decompressed but to fix an eye.

    A light is applied to the representatives, or to the axes that they share; every receiver sums what the mean of its
    cluster and P weighted vectors become, and the eye comes last: 3 M (P + 1) multiplications a light instead of M N,
    whatever the order of the light. Many lights under one eye are where clusters gain least.

    Buffers: `representatives [K + E, Q]`, or `[K + E, C, M, N]` without shared axes (`learn` may name them),
    `shared [Q or 0, C, M, N]`, and for `embedding_bag` int32 `rows`, `weights`, and `starts [G]`: of every receiver its
    mean, with 1, then the PCA vectors of its cluster. Weights stored as bytes are widened here.
    Source: Sloan, Hall, Hart and Snyder 2003, section 6.
    """

    learnable = ("representatives",)
    costs_by_order = False
    representatives: Tensor
    shared: Tensor
    rows: Tensor
    weights: Tensor
    starts: Tensor

    def __init__(self, signal: Clustered, making: Making, lost: Tensor | None = None):
        super().__init__(signal.shape)
        dtype = making.dtype
        representatives, shared = signal.representatives(dtype), signal.shared.detach().to(dtype)
        if len(shared):
            shared = _streamed(shared)
        else:
            representatives = _streamed(representatives.unflatten(1, shared.shape[1:]))
        hold(self, "representatives", representatives, making)
        self.register_buffer("shared", shared)
        label = signal.label.long()
        vectors, weights, starts = signal.blend(dtype)
        device = label.device
        receivers = torch.arange(len(label), device=device)
        first = starts + receivers
        owner = receivers.repeat_interleave(signal.counts[label])
        place = torch.arange(len(vectors), device=device) + owner + 1
        rows = torch.empty(len(label) + len(vectors), dtype=torch.int32, device=device)
        rows[first], rows[place] = label.int(), (len(signal.mean) + vectors).int()
        blended = torch.empty(len(rows), dtype=dtype, device=device)
        blended[first], blended[place] = 1, weights
        if lost is not None:
            blended[first[lost]] = 0
            blended[place[torch.isin(owner, lost)]] = 0
        self.register_buffer("rows", rows)
        self.register_buffer("weights", blended)
        self.register_buffer("starts", first.int())

    def blend(self, table: Float[Tensor, "R D"]) -> Float[Tensor, "G D"]:
        """What receivers have of the rows of `table`, one for each representative."""
        # Under autocast the table is narrower than the weights.
        table = table.to(self.weights.dtype)
        return with_all_derivatives(self._summed, self._by_receiver, table, self.weights)

    def _summed(self, table: Tensor, weights: Tensor) -> Tensor:
        return embedding_bag(self.rows, table, self.starts, mode="sum", per_sample_weights=weights)

    def _by_receiver(self, table: Tensor, weights: Tensor) -> Tensor:
        counts = torch.diff(self.starts, append=self.starts.new_full((1,), len(self.rows)))
        receiver = torch.arange(len(counts), device=counts.device)
        owner = receiver.repeat_interleave(counts, output_size=len(self.rows))
        weighted = table.index_select(0, self.rows) * weights.unsqueeze(1)
        return weighted.new_zeros(len(counts), table.shape[1]).index_add(0, owner, weighted)

    def sent(self, product: Callable[[Tensor], Tensor]) -> Float[Tensor, "R D"]:
        """What representatives become under `product`, linear, of signals `[Q or R, C, M, N]` to rows `[., D]`."""
        if len(self.shared):
            return self.representatives @ product(self.shared)
        return product(self.representatives)

    def toward(self, values: Tensor | None, frames: Tensor | None = None) -> Float[Tensor, "C N ..."]:
        """From the matrices, which are decompressed for it."""
        rows = self.blend(self.representatives.flatten(1))
        matrices = (rows @ self.shared.flatten(1) if len(self.shared) else rows).unflatten(1, self.shared.shape[1:])
        if values is None:
            return matrices[:, :, 0].permute(1, 2, 0)
        return matrix_vectors(matrices.transpose(0, 1), values)

    def under(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        found = self.blend(self.sent(lambda signal: _exits(signal, light)))
        return found.mT.reshape(3, *light.shape[:-2], self.shared.shape[2], len(found)).movedim(0, -3)

    def applied(self, columns: Float[Tensor, "N K"]) -> Float[Tensor, "G K"]:
        return self.blend(self.sent(lambda signal: signal[:, 0, 0] @ columns))

    def part(self, first: int, last: int, receivers: Tensor | None = None) -> ClusteredSignal:
        columns = slice(first * first, last * last)
        made = copy.copy(self)
        made._buffers, made._parameters = dict(self._buffers), {}
        count, channels, rows, _ = self.shape
        shared = len(self.shared) > 0
        made._buffers["shared"] = self.shared[..., columns]
        made._buffers["representatives"] = self.representatives if shared else self.representatives[..., columns]
        if receivers is not None:
            ends = torch.cat([self.starts[1:], self.starts.new_full((1,), len(self.rows))])
            starts = self.starts.index_select(0, receivers).long()
            counts = ends.index_select(0, receivers).long() - starts
            first_places = counts.cumsum(0) - counts
            total = int(counts.sum())
            places = torch.arange(total, device=starts.device)
            places = places + (starts - first_places).repeat_interleave(counts, output_size=total)
            made._buffers["rows"], made._buffers["weights"] = self.rows[places], self.weights[places]
            made._buffers["starts"] = first_places.int()
            count = len(receivers)
        made.shape = (count, channels, rows, last * last - first * first)
        return made

    def radiance(
        self, light: Tensor, values: Tensor | None, frames: Tensor | None = None, out: Tensor | None = None
    ) -> Float[Tensor, "... 3 G"]:
        if out is not None:
            raise InputError("out cannot be used with clustered transfer: leave it out")
        if values is None:
            return self.under(light).squeeze(-2)
        lights, eyes = light.shape[:-2], values.shape[:-2]
        batch = broadcast_shapes(lights, eyes)
        found = self.blend(self.sent(lambda signal: _exits(signal, light)))
        receivers, rows = values.shape[-2:]
        if is_one(math.prod(eyes)):
            # One product a receiver for all lights: half the time of products and sums.
            view = values.reshape(receivers, rows).contiguous().unsqueeze(-1)
            seen = torch.bmm(found.view(receivers, -1, rows), view)
            return seen.view(receivers, 3, *lights).movedim((0, 1), (-1, -2)).expand(*batch, 3, receivers)
        padded = (1,) * (len(batch) - len(lights)) + lights
        exits = found.view(receivers, 3, *padded, rows).movedim(1, -2)
        views = values.movedim(-2, 0).reshape(receivers, *(1,) * (len(batch) - len(eyes)), *eyes, 1, rows)
        return (exits * views).sum(-1).movedim(0, -1)


def _streamed(signal: Float[Tensor, "R C M N"]) -> Float[Tensor, "R C M N"]:
    """In memory `[C, N, R, M]`: a light reads it as one stream, three times faster."""
    return signal.permute(1, 3, 0, 2).contiguous().permute(2, 0, 3, 1)


def _exits(signal: Float[Tensor, "R C M N"], light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "R D"]:
    """Exit coefficients `3 B M` of every row of `signal` under all lights."""
    total, channels, rows, columns = signal.shape
    many = math.prod(light.shape[:-2])
    lights = light.movedim(-1, 0).reshape(channels, 3 // channels * many, columns)
    found = lights @ signal.permute(1, 3, 0, 2).reshape(channels, columns, total * rows)
    return found.reshape(3 * many, total, rows).transpose(0, 1).flatten(1)
