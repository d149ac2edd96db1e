"""Clustered PCA of what is larger than memory: clusters of a sample, then every receiver in the nearest of them."""

from __future__ import annotations

import math
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from torchprt.compression.clustering_data import Normal, normal_of
from torchprt.compression.cpca import ClusteredPca, flat_tensors, pack
from torchprt.compression.importance import root_of, weighed
from torchprt.compression.quantise import best_weights, check_half, counted, range_of
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.shared_axes import axes_of, coordinates_of
from torchprt.compression.subspaces import Advance, Subspaces, classify, fit, groups, one_thread, pieces
from torchprt.compression.transfer import Method, numbers_of, squared_error
from torchprt.errors import InputError
from torchprt.memory import available, check_memory
from torchprt.transfer import Clustered, Dense

T = TypeVar("T")

# Receivers that are classified together. A part of the bits of the result, so not a parameter.
_BLOCK = 1 << 14
# Receivers that stand for all, a cluster and at least, where the caller leaves it open.
_PER_CLUSTER, _LEAST = 512, 1 << 16
# Copies of all numbers that clustering makes, about.
_COPIES = 4
# Passes that fit means and axes to all receivers: each is a reading of the file.
_FITS = 3
# Bytes of scatter matrices, at most; where they are more, means and axes stay those of the sample.
_MOMENTS = 1 << 30
# Squared singular values below this part of the largest are rounding.
_ROUNDING = 1e-13
# Where no point is: a cluster that no receiver of the sample is in.
_FAR = 1e6


class SampledWarning(UserWarning):
    """Clusters are of a sample of the receivers, because all of them do not fit into memory."""


def is_sampled(dense: Dense, sample: int | None, coherence: float) -> bool:
    """Whether clusters are to be those of a sample: smaller than all, or none is asked for but all do not fit.

    Raises InputError if there would be nothing in it, or clusters are to be coherent, which takes all receivers.
    """
    receivers = dense.shape[0]
    if sample is not None and sample < 1:
        raise InputError(f"sample is {sample}: clusters are found from 1 receiver or more")
    needed, free = _COPIES * _bytes(dense, receivers), available() if dense.values.device.type == "cpu" else None
    large = sample is None and free is not None and needed > free and receivers > enough(0)
    if not large and (sample is None or sample >= receivers):
        return False
    if large:
        said = f"clustering of all {receivers} receivers needs about {needed / 2**30:.1f} GB, and "
        said += f"{(free or 0) / 2**30:.1f} GB are free: clusters are of a sample of them"
        warnings.warn(SampledWarning(said), stacklevel=3)
    if coherence > 0:
        raise InputError("coherence is given, but clusters are of a sample, and it takes all receivers: leave it out")
    return True


def _bytes(dense: Dense, receivers: int) -> int:
    size = torch.promote_types(dense.dtype, torch.float32).itemsize
    return size * receivers * math.prod(dense.shape[1:])


def enough(clusters: int) -> int:
    """Receivers that so many clusters are found from, unless the caller says how many."""
    return max(_LEAST, _PER_CLUSTER * clusters)


def sample_of(dense: Dense, count: int, seed: int) -> Float[Tensor, "s S"]:
    """The numbers of `count` receivers, ascending: of as many runs of equal length one each, drawn with `seed`.

    A step of the same length everywhere would meet the columns of a map, or the layers of a grid.
    """
    receivers = dense.shape[0]
    check_memory(_COPIES * _bytes(dense, count), f"clustering of {count} receivers", "give a smaller sample")
    bounds = torch.arange(count + 1, device="cpu") * receivers // count
    width = bounds.diff()
    drawn = torch.rand(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64, device="cpu")
    rows = (bounds[:-1] + torch.minimum((drawn * width).long(), width - 1)).to(dense.values.device)
    values = dense.values.detach()
    made = torch.empty(
        count, math.prod(dense.shape[1:]), dtype=torch.promote_types(dense.dtype, torch.float32), device=values.device
    )
    # Row by row, so that a mapped file is read once, from its beginning to its end.
    vectors = [row for channel in values for row in channel] if values.ndim == 3 else list(values)
    parts = made.view(count, len(vectors), -1)
    for number, one in enumerate(vectors):
        parts[:, number] = one.index_select(0, rows).view(count, -1)
    return made


def encode_sampled(
    dense: Dense,
    clusters: int,
    components: int,
    *,
    sample: int | None,
    method: Method,
    bits: int,
    shared: int,
    iterations: int,
    seed: int,
    importance: Tensor | None,
    passes: Passes,
) -> Clustered:
    """As `encode`, with clusters of `sample` receivers (`enough` of them if None).

    Then three passes over all receivers, in blocks of 16384: each goes to the nearest subspace, and means and PCA
    vectors become those of all (unless the scatter matrices of the clusters take more than 1 GiB: then those of the
    sample stay); each goes to the nearest of these, whatever the method; each gets its best weights. Given those,
    label, weights and error of a receiver depend on what is in its block alone; and sums are over blocks in order:
    the same seed is the same bits, however many threads there are and wherever the numbers stand. In memory is the
    sample, and what is stored of a receiver.
    """
    receivers = dense.shape[0]
    count = min(receivers, enough(clusters) if sample is None else sample)
    if clusters > count:
        raise InputError(f"clusters is {clusters}, but the sample is of {count} receivers: give a larger sample")
    passes = passes.named(f"{clusters}-{components}-{shared}-{count}")
    with torch.no_grad():
        data = sample_of(dense, count, seed)
        space = _Space.of(data, shared, importance)
        # Under the importance these axes are orthonormal: plain distances in them are the weighed ones.
        importance = None if shared else importance
        coordinates = space.coordinates(data)
        packed = pack(coordinates, clusters, components, method, iterations, seed, importance, passes)
        found = _Found.of(packed, coordinates, space, bits, dense)
        del data, coordinates, packed
        return _Streamed(dense, found, passes).signal(method)


@dataclass(frozen=True)
class _Space:
    """Where clusters are: the numbers of receivers, or their coordinates in `axes` that all clusters share."""

    axes: Tensor | None
    into: Tensor | None
    root: Tensor | None

    @classmethod
    def of(cls, data: Tensor, shared: int, importance: Tensor | None) -> _Space:
        if shared:
            with one_thread():
                return cls(*axes_of(data, shared, importance), None)
        return cls(None, None, None if importance is None else root_of(importance, data))

    def coordinates(self, data: Tensor) -> Tensor:
        return data if self.into is None else coordinates_of(data, self.into)

    def metric(self, coordinates: Tensor) -> Tensor:
        return coordinates if self.root is None else weighed(coordinates, self.root)


@dataclass(frozen=True)
class _Found:
    """What a sample says of all receivers: which subspaces are `near` them, and what is stored of those, in `bits`.

    `low`, `step [K, P]`: the ranges of weights of one byte.
    """

    space: _Space
    normal: Normal
    near: Subspaces
    mean: Tensor
    basis: Tensor
    shared: Tensor
    offsets: Tensor
    bits: int
    low: Tensor | None = None
    step: Tensor | None = None

    @classmethod
    def of(cls, packed: ClusteredPca, coordinates: Tensor, space: _Space, bits: int, dense: Dense) -> _Found:
        metric = space.metric(coordinates)
        normal = normal_of(metric)
        with one_thread():
            near = fit(normal.of(metric), packed.label, len(packed.mean), int(packed.counts.max()))
        near = replace(near, counts=packed.counts)
        near.mean[near.sizes == 0] = _FAR
        axes = packed.mean.new_zeros(0, math.prod(dense.shape[1:])) if space.axes is None else space.axes
        shared = axes.unflatten(1, dense.shape[1:]).contiguous()
        return cls(space, normal, near, packed.mean, packed.basis, shared, packed.offsets, bits)

    def refitted(self, moments: _Moments) -> _Found:
        """With the means and principal axes of all receivers, as `moments` in the metric have them."""
        rows = int(self.counts.max())
        mean, gram = moments.mean, moments.gram
        basis = _principal(gram, rows)
        space = self.normal.axes
        near = replace(
            self.near,
            mean=self.normal.of(mean.to(self.mean.dtype)).double(),
            basis=basis if space is None else _principal(space.double().mT @ gram @ space.double(), rows),
            sizes=moments.sizes,
        )
        near.mean[moments.sizes == 0] = _FAR
        kept = basis[self.kept]
        if self.space.root is not None:
            mean, kept = (torch.linalg.solve(self.space.root, each, left=False) for each in (mean, kept))
        return replace(self, near=near, mean=mean.to(self.mean.dtype), basis=kept.to(self.basis.dtype))

    def stored(self) -> _Found:
        """With representatives as they are stored."""
        if self.bits == 32:
            return self
        none = self.mean.new_zeros(0, int(self.counts.max()))
        check_half(
            ClusteredPca(self.offsets[:0], self.mean, self.basis, self.offsets, none, none[:, :0].sum(1).double())
        )
        return replace(self, **{name: getattr(self, name).half() for name in ("mean", "basis", "shared")})

    @property
    def counts(self) -> Tensor:
        return self.offsets.diff()

    @property
    def kept(self) -> Tensor:
        """Which of `[K, P]` there are."""
        return torch.arange(int(self.counts.max()), device=self.offsets.device) < self.counts[:, None]

    @property
    def moments_bytes(self) -> int:
        """Of the scatter matrices of all clusters."""
        return 8 * len(self.mean) * self.mean.shape[1] ** 2

    def label(self, data: Tensor) -> Int64[Tensor, "n"]:
        """The nearest subspace of every receiver."""
        points = self.normal.of(self.space.metric(self.space.coordinates(data)))
        return classify(points, self.near)[0]

    def weights(self, data: Tensor, label: Tensor) -> Tensor:
        """`[n, P]` float64."""
        none = data.new_zeros(len(data), int(self.counts.max()))
        stored = ClusteredPca(label, self.mean, self.basis, self.offsets, none, none[:, :0].sum(1, dtype=torch.float64))
        return best_weights(self.space.coordinates(data), stored, self.space.root)

    def code(self, weights: Tensor, label: Tensor, dtype: torch.dtype) -> Tensor:
        """Weights as they are stored."""
        if self.low is not None and self.step is not None:
            return counted(weights, label, self.low, self.step)
        code = weights.to(torch.float16 if self.bits == 16 else dtype)
        if not bool(code.isfinite().all()):
            raise InputError("weights of packed are larger than float16 holds: scale the data, or give 32 bits")
        return code

    def signal(self, **tensors: Any) -> Clustered:
        """Of receivers with these labels, weights and errors."""
        none = self.mean.new_zeros(0, dtype=torch.float32)
        ranges: dict[str, Any] = {
            name: getattr(self, name)[self.kept] if self.bits == 8 else none for name in ("low", "step")
        }
        parts: dict[str, Any] = {
            "mean": self.mean,
            "basis": self.basis,
            "shared": self.shared,
            "offsets": self.offsets.int(),
        }
        return Clustered(**tensors, **parts, **ranges)


class _Moments:
    """Sums over receivers, a block after the other, float64: means `[K, S]` and scatter matrices `gram [K, S, S]`."""

    def __init__(self, near: Tensor):
        """`near [K, S]`: about where the means will be."""
        clusters, width = near.shape
        self._near, self._sum = near, torch.zeros_like(near)
        self._gram = near.new_zeros(clusters, width, width)
        self.sizes = torch.zeros(clusters, dtype=torch.int64, device=near.device)

    def add(self, points: Tensor, label: Tensor) -> None:
        clusters, width = self._near.shape
        self.sizes += torch.bincount(label, minlength=clusters)
        self._sum.index_add_(0, label, points.double() - self._near[label])
        for chosen, some, real in groups(label, clusters, width):
            for rows, of in pieces(some, real, width):
                centred = (points[rows].double() - self._near[chosen, None]).mul_(of[:, :, None])
                self._gram.index_add_(0, chosen, centred.mT @ centred)

    @property
    def _off(self) -> Tensor:
        return self._sum / self.sizes.clamp(min=1)[:, None]

    @property
    def mean(self) -> Tensor:
        return self._near + self._off

    @property
    def gram(self) -> Tensor:
        """About the means."""
        off = self._off
        return self._gram - self.sizes[:, None, None] * off[:, :, None] * off[:, None, :]


def _principal(gram: Tensor, rows: int) -> Tensor:
    """The first axes `[K, rows, S]` of scatter matrices; zero rows where a cluster has no more."""
    found = gram.new_zeros(len(gram), rows, gram.shape[1])
    for one, into in zip(gram, found, strict=True):
        values, vectors = torch.linalg.eigh(one)
        count = min(rows, int((values > _ROUNDING * values[-1].clamp(min=0)).sum()))
        into[:count] = vectors.flip(1)[:, :count].mT
    return found


@dataclass(frozen=True)
class _Streamed:
    """A dense signal put into what was `found`, a block at a time."""

    dense: Dense
    found: _Found
    passes: Passes

    def signal(self, method: str) -> Clustered:
        receivers = self.dense.shape[0]
        found = self.found
        if found.moments_bytes <= _MOMENTS:
            with one_thread(), self.passes.stage("fitting", _FITS, receivers) as stage:
                for _ in range(_FITS):
                    found = self._refitted(found, stage.advance)
        found = found.stored()
        with one_thread(), self.passes.stage("assigning", 1, receivers) as stage:
            label, low, step = self._assigned(found, stage.advance)
        found = replace(found, low=low, step=step)
        kept = sum(int(found.counts[some.long()].sum()) for some in label.split(_BLOCK))
        weights: Tensor | None = None
        squared = torch.empty(receivers, device=label.device)
        power = error = 0.0
        first = 0
        with one_thread(), self.passes.stage("weights", 1, receivers) as stage:

            def work(block: slice) -> tuple[Tensor, Tensor, float]:
                data, of = self._numbers(block), label[block].long()
                code = found.code(found.weights(data, of), of, data.dtype)
                flat = flat_tensors(of, found.offsets, code)["weights"]
                none = data.new_zeros(len(data))
                made = squared_error(data, found.signal(label=label[block], weights=flat, squared_error=none))
                return flat, made, float(data.double().square().sum())

            for block, (flat, made, of_block) in self._blocks(work, stage.advance):
                weights = flat.new_empty(kept) if weights is None else weights
                weights[first : first + len(flat)] = flat
                first += len(flat)
                squared[block] = made.float()
                error, power = error + float(made.sum()), power + of_block
        assert weights is not None
        relative = math.sqrt(error / power) if power > 0 else 0.0
        whole = found.signal(label=label, weights=weights, squared_error=squared)
        return whole.replace(method=method, compression_error=relative)

    def _refitted(self, found: _Found, advance: Advance) -> _Found:
        """What was found, with means and axes of all receivers that it is nearest to."""
        moments = _Moments(found.space.metric(found.mean).double())

        def work(block: slice) -> tuple[Tensor, Tensor]:
            data = self._numbers(block)
            return found.space.metric(found.space.coordinates(data)), found.label(data)

        for _, (points, of) in self._blocks(work, advance):
            moments.add(points, of)
        return found.refitted(moments)

    def _assigned(self, found: _Found, advance: Advance) -> tuple[Tensor, Tensor | None, Tensor | None]:
        """Labels, as narrow as they may be, and the ranges of weights if those are of one byte."""
        empty = flat_tensors(found.counts[:0], found.offsets, found.mean.new_zeros(0, found.kept.shape[1]))["label"]
        label = empty.new_empty(self.dense.shape[0])
        least = torch.full(found.kept.shape, math.inf, dtype=torch.float64, device=label.device)
        most = -least

        def work(block: slice) -> tuple[Tensor, Tensor | None]:
            data = self._numbers(block)
            of = found.label(data)
            return of, found.weights(data, of) if found.bits == 8 else None

        for block, (of, weights) in self._blocks(work, advance):
            label[block] = of.to(label.dtype)
            if weights is not None:
                index = of[:, None].expand_as(weights)
                least.scatter_reduce_(0, index, weights, "amin")
                most.scatter_reduce_(0, index, weights, "amax")
        if found.bits != 8:
            return label, None, None
        none = least > most
        return label, *range_of(least.masked_fill(none, 0), most.masked_fill(none, 0))

    def _numbers(self, block: slice) -> Tensor:
        values = self.dense.values
        data = numbers_of(Dense(values=values[..., block] if values.ndim == 3 else values[:, block]))
        if not bool(data.isfinite().all()):
            row = block.start + int((~data.isfinite()).any(1).nonzero()[0, 0])
            raise InputError(
                f"data holds a number that is not finite, first in row {row}: mend the transfer it is from"
            )
        return data

    def _blocks(self, work: Callable[[slice], T], advance: Advance) -> Iterator[tuple[slice, T]]:
        """What `work` makes of every block, in order; a few are under way at a time."""
        receivers = self.dense.shape[0]
        waiting: deque[tuple[slice, Future[T]]] = deque()

        def next_one() -> tuple[slice, T]:
            block, future = waiting.popleft()
            made = future.result()
            advance(block.stop - block.start)
            return block, made

        with ThreadPoolExecutor(self.passes.threads) as pool:
            try:
                for start in range(0, receivers, _BLOCK):
                    block = slice(start, min(start + _BLOCK, receivers))
                    waiting.append((block, pool.submit(work, block)))
                    if len(waiting) > self.passes.threads:
                        yield next_one()
                while waiting:
                    yield next_one()
            except BaseException:
                # Ctrl-C: what runs is finished, the rest is not begun.
                pool.shutdown(cancel_futures=True)
                raise
