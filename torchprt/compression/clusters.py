"""Vector quantisation: points in clusters, each near the mean of its own (Linde, Buzo and Gray 1980)."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from torchprt.compression.clustering_data import check, normalised
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.subspaces import Subspaces, classify, fill_empty, means, one_thread

# Passes over all points, at most, as in figure 2 of Sloan et al. 2003.
PASSES = 20
# The start is drawn from so many points, or so many a cluster: a good spread does not need them all.
_LEAST_POINTS = 1 << 14
_POINTS_PER_CLUSTER = 64


def vector_quantise(
    data: Float[Tensor, "V S"], clusters: int, *, seed: int = 0, iterations: int = 20
) -> tuple[Int64[Tensor, "V"], Float[Tensor, "K S"]]:
    """The cluster of every point, and the mean of every cluster.

    Starts from a greedy k-means++ spread and passes over all points until none moves, at most `iterations` times. An
    empty cluster takes the worst-fitted point; one that no point needs (fewer distinct points than clusters) stays
    empty, with a mean of zero. Same seed, same bits, however many threads torch has. The squared error never
    rises from one iteration to the next, beyond rounding.

    Raises InputError if there are fewer points than clusters, no cluster, or a number that is not finite.
    Source: Linde, Buzo and Gray 1980; Arthur and Vassilvitskii 2007; Sloan et al. 2003, section 4.1.
    """
    passes = Passes()
    with torch.no_grad(), one_thread():
        check(data, clusters, iterations)
        label = quantise(normalised(data), clusters, seed, iterations, passes)
        return label, means(data, label, clusters).to(data.dtype)


def quantise(points: Tensor, clusters: int, seed: int, iterations: int, passes: Passes) -> Tensor:
    """The clusters `[V]` of points that are checked, centred and of unit size."""
    if clusters == 1:
        return torch.zeros(len(points), dtype=torch.int64, device=points.device)
    with passes.stage("clusters", iterations, len(points)) as stage:
        label = stage.kept.get("label")
        while stage.done < iterations:
            former = label
            if former is None:
                centres = spread(points, clusters, torch.Generator().manual_seed(seed)).double()
            else:
                centres = means(points, former, clusters)
            label, error = classify(points, _points(centres), passes.threads, stage.advance)
            label = fill_empty(label, error, clusters)
            stage.keep({"label": label}, last=former is not None and torch.equal(label, former))
    assert label is not None
    return label


def spread(points: Tensor, clusters: int, generator: torch.Generator) -> Tensor:
    """Centres `[K, S]` to start from: points, each drawn with a probability that is its squared distance to the others.

    Of a few drawn at a time the one is kept that leaves the least error (greedy k-means++).
    """
    most = max(_LEAST_POINTS, _POINTS_PER_CLUSTER * clusters)
    pool = points[torch.randperm(len(points), generator=generator, device="cpu")[:most].to(points.device)]
    transposed = pool.mT.contiguous()
    squares = pool.square().sum(1)
    tries = 2 + int(math.log(clusters))
    chosen = torch.zeros(clusters, dtype=torch.int64, device=points.device)
    distance = _distance(pool, transposed, squares, chosen[:1])[0]
    for cluster in range(1, clusters):
        total = distance.cumsum(0, dtype=torch.float64)
        drawn = torch.rand(tries, generator=generator, dtype=torch.float64, device="cpu").to(total.device) * total[-1]
        candidates = torch.searchsorted(total, drawn, right=True).clamp(max=len(pool) - 1)
        left = torch.minimum(distance, _distance(pool, transposed, squares, candidates))
        best = left.sum(1).argmin()
        chosen[cluster], distance = candidates[best], left[best]
    return pool[chosen]


def _distance(pool: Tensor, transposed: Tensor, squares: Tensor, chosen: Tensor) -> Tensor:
    offset = squares[chosen, None] + squares
    return torch.addmm(offset, pool[chosen], transposed, alpha=-2).clamp_(min=0)


def _points(centres: Tensor) -> Subspaces:
    """Subspaces without any dimension."""
    none = centres.new_zeros(len(centres))
    return Subspaces(centres, centres.new_zeros(len(centres), 0, centres.shape[1]), none[:, None][:, :0], none,
                     none.long(), none.long())  # fmt: skip
