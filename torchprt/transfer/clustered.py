"""A signal by clustered PCA: the receivers of a cluster share an affine subspace and keep a few weights each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchprt.errors import InputError
from torchprt.transfer.dense import Dense
from torchprt.transfer.layout import FLOATS, WHOLE, Layout
from torchprt.transfer.signal import Signal, check_counts, columns_of

_LABELS = (torch.uint8, torch.int16, torch.int32, torch.int64)
_CHUNK = 1 << 14


@dataclass(kw_only=True, repr=False)
class Clustered(Signal):
    """The matrix of a receiver is `mean[k] + sum_i w_i basis[offsets[k] + i]`, k its label, i below the count
    `offsets[k + 1] - offsets[k]` of its cluster.

    A light is applied to the K + E representatives and then weighted: the cost a receiver does not depend on the order.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 4 and 6.

    - `label [G]`: the cluster of every receiver. `weights [W]`: those of the first receiver, of the second, ..., each
      as many as its cluster has PCA vectors.
    - `mean [K, Q]`, `basis [E, Q]`: representatives, `offsets [K + 1]`. Q = C M N, or, with bases of two levels, Q
      numbers that stand for `q @ shared`, `shared [Q, C, M, N]` being axes that all clusters share; else `shared` has
      no rows, and its other sizes say what the numbers are.
    - `low [E]`, `step [E]`: if weights are bytes, those of vector e are `low[e] + step[e] * byte`; else empty.
    - `squared_error [G]`: what compression cost each receiver, summed over its numbers; `compression_error`: RMS over
      all, relative to what was compressed; `method`: how clusters were found.
    """

    kind: ClassVar[str] = "clustered"
    layouts: ClassVar[dict[str, Layout]] = {
        "label": Layout(("G",), _LABELS),
        "weights": Layout(("W",), (*FLOATS, torch.uint8)),
        "mean": Layout(("K", "Q")),
        "basis": Layout(("E", "Q")),
        "shared": Layout(("Q|0", "C", "M", "N")),
        "offsets": Layout(("O",), WHOLE),
        "low": Layout(("E|0",)),
        "step": Layout(("E|0",)),
        "squared_error": Layout(("G",)),
    }

    stored: ClassVar[tuple[str, ...]] = ("mean", "basis", "shared", "low", "step")

    label: Tensor
    weights: Tensor
    mean: Tensor
    basis: Tensor
    shared: Tensor
    offsets: Tensor
    low: Tensor
    step: Tensor
    squared_error: Tensor
    method: str = "iterative"
    compression_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_counts(self.shared.shape[1], self.shared.shape[3])
        if len(self.offsets) != len(self.mean) + 1:
            raise InputError(
                f"offsets of the transfer are {len(self.offsets)} for {len(self.mean)} clusters: one more is needed"
            )
        numbers = math.prod(self.shared.shape[1:])
        if not len(self.shared) and self.mean.shape[1] != numbers:
            raise InputError(
                f"mean of the transfer has {self.mean.shape[1]} numbers for a signal of {numbers}: without shared axes "
                "they must be the same"
            )
        ranges = len(self.basis) if self.weights.dtype == torch.uint8 else 0
        if len(self.low) != ranges or len(self.step) != ranges:
            raise InputError(
                f"low and step of the transfer have {len(self.low)} and {len(self.step)} entries: weights of "
                f"{str(self.weights.dtype).removeprefix('torch.')} take {ranges}"
            )

    @property
    def shape(self) -> tuple[int, int, int, int]:
        _, channels, rows, columns = self.shared.shape
        return len(self.label), channels, rows, columns

    @property
    def counts(self) -> Int[Tensor, "K"]:
        """PCA vectors of every cluster."""
        return self.offsets.long().diff()

    def cluster_error(self) -> Float[Tensor, "K"]:
        """Squared error of every cluster, float64."""
        total = torch.zeros(len(self.mean), dtype=torch.float64, device=self.label.device)
        return total.index_add_(0, self.label.long(), self.squared_error.double())

    def blend(self, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of `basis` and their weights, `[W]` both, and where those of every receiver start."""
        label = self.label.long()
        count = self.counts[label]
        starts = count.cumsum(0) - count
        place = torch.arange(len(self.weights), device=label.device) - starts.repeat_interleave(count)
        rows = self.offsets.long()[label].repeat_interleave(count) + place
        weights = self.weights.to(dtype)
        if self.weights.dtype == torch.uint8:
            weights = torch.addcmul(self.low.to(dtype)[rows], self.step.to(dtype)[rows], weights)
        return rows, weights, starts

    def representatives(self, dtype: torch.dtype) -> Float[Tensor, "R Q"]:
        """Means, then PCA vectors: R = K + E."""
        return torch.cat([self.mean, self.basis]).detach().to(dtype)

    def numbers(self) -> Float[Tensor, "G _"]:
        """All C M N numbers of every receiver, in bounded temporary memory, in float32 (float64 as the means)."""
        dtype = torch.promote_types(self.mean.dtype, torch.float32)
        rows, weights, starts = self.blend(dtype)
        mean, basis, shared = (part.to(dtype) for part in (self.mean, self.basis, self.shared.flatten(1)))
        label = self.label.long()
        result = mean.new_empty(len(label), shared.shape[1])
        bounds = torch.cat([starts, starts.new_tensor([len(rows)])])
        for first in range(0, len(label), _CHUNK):
            last = min(first + _CHUNK, len(label))
            part = slice(int(bounds[first]), int(bounds[last]))
            some = mean[label[first:last]]
            if part.stop > part.start:
                places = starts[first:last] - part.start
                some = some + embedding_bag(rows[part], basis, places, mode="sum", per_sample_weights=weights[part])
            result[first:last] = some @ shared if len(shared) else some
        return result

    def dense(self) -> Dense:
        """Vectors where M = 1, else matrices."""
        _, _, rows, _ = self.shape
        matrices = self.numbers().unflatten(1, self.shared.shape[1:])
        values = matrices[:, :, 0].permute(1, 2, 0) if rows == 1 else matrices.transpose(0, 1)
        return Dense(values=values.contiguous())

    def to_order(self, order: int) -> Clustered:
        count = columns_of(order, math.isqrt(self.shape[3]))
        return self._mapped(lambda signal: signal[..., :count])

    def take(self, index: Int[Tensor, "g"]) -> Clustered:
        count = self.counts[self.label.long()]
        starts = (count.cumsum(0) - count)[index]
        count = count[index]
        first = count.cumsum(0) - count
        place = torch.arange(int(count.sum()), device=index.device) - first.repeat_interleave(count)
        return self.replace(
            label=self.label[index],
            weights=self.weights[starts.repeat_interleave(count) + place],
            squared_error=self.squared_error[index],
        )

    def combined(self, rows: Float[Tensor, "R M"]) -> Clustered:
        """`squared_error` stays that of the former rows."""
        return self._mapped(lambda signal: (rows @ signal.double()).to(signal.dtype))

    def check(self, of: str = "") -> None:
        """InputError if a tensor holds NaN or infinity, or labels, offsets and weights do not fit together."""
        super().check(of)
        label, offsets, counts = self.label, self.offsets.long(), self.counts
        # As plain numbers: a count of 256 is 0 among labels of a byte.
        if len(label) and (int(label.min()) < 0 or int(label.max()) >= len(self.mean)):
            raise InputError("label of the transfer names clusters that it does not have: compress it again")
        whole = int(offsets[0]) == 0 and int(offsets[-1]) == len(self.basis)
        if not whole or (len(counts) and counts.min() < 0):
            raise InputError("offsets of the transfer do not count its PCA vectors: compress it again")
        wanted = sum(int(counts[some.long()].sum()) for some in label.split(1 << 20))
        if wanted != len(self.weights):
            raise InputError(
                f"weights of the transfer are {len(self.weights)}, but its receivers have {wanted}: compress it again"
            )

    def _mapped(self, change: Callable[[Tensor], Tensor]) -> Clustered:
        """The same after a linear `change` of signals `[., C, M, N]`: of the shared axes, or of the representatives."""
        if len(self.shared):
            return self.replace(shared=change(self.shared).contiguous())
        shape = self.shared.shape[1:]
        mean, basis = (change(part.unflatten(1, shape)).contiguous() for part in (self.mean, self.basis))
        return self.replace(mean=mean.flatten(1), basis=basis.flatten(1), shared=mean[:0])
