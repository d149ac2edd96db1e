"""Affine subspaces, one a cluster: fitted to the points of the cluster, and told which point is nearest to which."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from torch import Tensor

# Numbers in a temporary array (float64: 16 MiB), and rows that a thread classifies at a time. Both are part of the
# bits of the result, so not parameters.
_NUMBERS = 1 << 21
_PIECE = 1 << 13
# Clusters whose sizes differ by more than this are not padded to the same length.
_SIMILAR = 0.75
# Squared singular values below this part of the largest are rounding.
_ROUNDING = 1e-13

# Told how many more points are done.
Advance = Callable[[int], None]


def silent(points: int) -> None:
    """Told, and does nothing."""


@contextmanager
def one_thread() -> Iterator[int]:
    """Torch on one thread, and how many it had: the bits of a product depend on how it is split."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield threads
    finally:
        torch.set_num_threads(threads)


@dataclass
class Subspaces:
    """The points `mean_k + sum_i w_i basis_ki`, i below `counts_k`, for every cluster k.

    `mean [K, S]`, `basis [K, R, S]` float64 with orthonormal rows (or zero rows, where the cluster has no more
    dimensions), `energy [K, R]`: the squared error that each row removes, falling; `spread [K]`: the squared error
    without any; `sizes [K]`: points in the cluster. R is how many rows are kept, at least the largest count.
    """

    mean: Tensor
    basis: Tensor
    energy: Tensor
    spread: Tensor
    sizes: Tensor
    counts: Tensor

    def error(self) -> float:
        """Squared error that is left, over all points."""
        kept = torch.arange(self.energy.shape[1], device=self.counts.device) < self.counts[:, None]
        return float((self.spread - (self.energy * kept).sum(1)).clamp(min=0).sum())


def groups(label: Tensor, clusters: int, width: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Clusters of similar size together: their numbers `[g]`, their points `[g, m]`, which of those are real.

    `width` numbers a point bound g; every cluster that is not empty comes once.
    """
    sizes = torch.bincount(label, minlength=clusters)
    order = label.argsort(stable=True)
    starts = sizes.cumsum(0) - sizes
    ranked = sizes.argsort(descending=True, stable=True)
    lengths: list[int] = sizes[ranked].tolist()
    filled = clusters - lengths.count(0)
    first = 0
    while first < filled:
        longest = lengths[first]
        most = max(1, _NUMBERS // (max(longest, width) * width))
        last = first + 1
        while last < filled and last - first < most and lengths[last] >= _SIMILAR * longest:
            last += 1
        chosen = ranked[first:last]
        place = torch.arange(longest, device=label.device)
        real = place < sizes[chosen, None]
        yield chosen, order[torch.where(real, starts[chosen, None] + place, starts[chosen, None])], real
        first = last


def pieces(rows: Tensor, real: Tensor, width: int) -> Iterator[tuple[Tensor, Tensor]]:
    """What `groups` gives, in lengths that bound memory even if one cluster holds every point."""
    step = max(1, _NUMBERS // (rows.shape[0] * width))
    yield from zip(rows.split(step, 1), real.split(step, 1), strict=True)


def means(data: Tensor, label: Tensor, clusters: int) -> Tensor:
    """`[K, S]` float64; zero for an empty cluster."""
    total = data.new_zeros(clusters, data.shape[1], dtype=torch.float64)
    step = max(1, _NUMBERS // data.shape[1])
    for some, of in zip(data.split(step), label.split(step), strict=True):
        total.index_add_(0, of, some.double())
    return total / torch.bincount(label, minlength=clusters).clamp(min=1)[:, None]


def fit(data: Tensor, label: Tensor, clusters: int, rows: int, advance: Advance = silent) -> Subspaces:
    """The subspaces of least squared error: mean and `rows` principal axes of every cluster.

    From the Gram matrix of the smaller side, as section 4.1 of Sloan et al. 2003, in float64.
    """
    width = data.shape[1]
    mean = means(data, label, clusters)
    basis = mean.new_zeros(clusters, rows, width)
    energy, spread = mean.new_zeros(clusters, rows), mean.new_zeros(clusters)
    for chosen, points, real in groups(label, clusters, width):
        if points.shape[1] < width:
            centred = _centred(data, mean[chosen], points, real)
            gram = centred @ centred.mT
        else:
            gram = mean.new_zeros(len(chosen), width, width)
            for some, of in pieces(points, real, width):
                centred = _centred(data, mean[chosen], some, of)
                gram.baddbmm_(centred.mT, centred)
        spread[chosen] = gram.diagonal(dim1=1, dim2=2).sum(1)
        advance(int(real.sum()))
        if rows == 0:
            continue
        values, vectors = torch.linalg.eigh(gram)
        found = min(rows, values.shape[1])
        values = values.flip(1)[:, :found].clamp(min=0)
        vectors = vectors.flip(2)[:, :, :found].mT
        if points.shape[1] < width:
            # Axes of the points themselves from those of their products; the length of a vanishing one is rounding.
            values = values * (values > _ROUNDING * values[:, :1])
            vectors = vectors @ centred
            length = torch.linalg.vector_norm(vectors, dim=2, keepdim=True)
            vectors = torch.where(values[:, :, None] > 0, vectors / length.clamp(min=1e-300), 0.0)
        basis[chosen, :found] = vectors
        energy[chosen, :found] = values
    sizes = torch.bincount(label, minlength=clusters)
    return Subspaces(mean, basis, energy, spread, sizes, torch.full_like(sizes, rows))


def _centred(data: Tensor, mean: Tensor, points: Tensor, real: Tensor) -> Tensor:
    return (data[points].double() - mean[:, None]).mul_(real[:, :, None])


def classify(data: Tensor, spaces: Subspaces, threads: int = 1, advance: Advance = silent) -> tuple[Tensor, Tensor]:
    """The subspace nearest to every point, `[V]`, and the squared distance `[V]` to the rounding of `data`."""
    label, error = _nearest(data, spaces, threads, advance, second=False)
    return label, error


def runners_up(
    data: Tensor, spaces: Subspaces, threads: int = 1, advance: Advance = silent
) -> tuple[Tensor, Tensor, Tensor]:
    """The nearest subspace of every point, the one that is nearest without it, and how much farther that is, squared.

    There must be two subspaces.
    """
    label, error, other, further = _nearest(data, spaces, threads, advance, second=True)
    return label, other, (further - error).clamp_(min=0)


def _nearest(data: Tensor, spaces: Subspaces, threads: int, advance: Advance, *, second: bool) -> list[Tensor]:
    """Nearest and squared distance; and of the second nearest the same, if asked for.

    |x - x0|^2 - sum_i ((x - x0) . x_i)^2 of all clusters is one product with `[x0 | x_1 | x_2 ...]`, components
    first; clusters with more components come first, so that every component is a run of rows.
    """
    clusters = len(spaces.mean)
    ranked = spaces.counts.argsort(descending=True, stable=True)
    mean, basis, counts = spaces.mean[ranked], spaces.basis[ranked], spaces.counts[ranked]
    runs = [int((counts > i).sum()) for i in range(int(counts[0]))]
    factors = [-2 * mean] + [basis[:run, i] for i, run in enumerate(runs)]
    constants = [mean.square().sum(1)] + [-(basis[:run, i] * mean[:run]).sum(1) for i, run in enumerate(runs)]
    product = torch.cat(factors).to(data.dtype)
    offset = torch.cat(constants).to(data.dtype)[:, None]
    columns = max(16, min(256, (1 << 19) // len(product)))

    def piece(rows: Tensor) -> list[Tensor]:
        found = []
        for some in rows.split(columns):
            result = torch.addmm(offset, product, some.mT)
            score, first = result[:clusters], clusters
            for run in runs:
                along = result[first : first + run]
                score[:run].addcmul_(along, along, value=-1)
                first += run
            squares = some.square().sum(1)
            least, label = score.min(0)
            nearest = [ranked[label], (least + squares).clamp_(min=0)]
            if second:
                further, other = score.scatter_(0, label[None], float("inf")).min(0)
                nearest += [ranked[other], (further + squares).clamp_(min=0)]
            found.append(nearest)
        return [torch.cat(parts) for parts in zip(*found, strict=True)]

    pieces_found = []
    with ThreadPoolExecutor(threads) as pool:
        try:
            for found in pool.map(piece, data.split(_PIECE)):
                pieces_found.append(found)
                advance(len(found[0]))
        except BaseException:
            # Ctrl-C: what runs is finished, the rest is not begun.
            pool.shutdown(cancel_futures=True)
            raise
    return [torch.cat(parts) for parts in zip(*pieces_found, strict=True)]


def fill_empty(label: Tensor, error: Tensor, clusters: int) -> Tensor:
    """`label` with the worst-fitted points moved into the empty clusters, one each; ever so, as long as there are any.

    A point alone in its cluster stays, and so does one that is fitted exactly.
    """
    sizes = torch.bincount(label, minlength=clusters)
    empty = (sizes == 0).nonzero()[:, 0]
    if not len(empty):
        return label
    error = torch.where(sizes[label] > 1, error, 0.0)
    worst = error.argsort(descending=True, stable=True)[: len(empty)]
    worst = worst[error[worst] > 0]
    label = label.clone()
    label[worst] = empty[: len(worst)]
    return label
