"""Better clusters for the same numbers: classified by approximation error, PCA vectors where they gain most."""

from __future__ import annotations

from dataclasses import fields

import torch
from torch import Tensor

from torchprt.compress.subspaces import Subspaces, classify, fill_empty, fit, runners_up

# Clusters to begin with, in multiples of those to end with; those missed least are dropped in so many steps, with so
# many passes after each, and at the end up to so many times the passes that a component takes.
_SURPLUS = 2
_STEPS = 4
_STEP_PASSES = 2
_LAST = 10
# Less gained by a pass, relative: no further pass.
_SETTLED = 1e-3


def surplus(points: int, clusters: int) -> int:
    """How many clusters `grow` begins with."""
    return min(points, _SURPLUS * clusters)


def grow(points: Tensor, label: Tensor, clusters: int, components: int, iterations: int, threads: int) -> Tensor:
    """Labels after passes of classification and PCA, from those of vector quantisation into `surplus` clusters.

    With 1, 2, ... `components` (Kambhatla and Leen 1997; Sloan et al. 2003, section 4.2), which avoids bad local
    minima; then with fewer and fewer clusters, until there are `clusters`: those are dropped whose points lose least
    without them, so that clusters end up where error is, which passes alone do not bring about.
    """
    count = surplus(len(points), clusters)
    spaces = fit(points, label, count, components)
    for kept in range(1, components + 1):
        for _ in range(iterations):
            spaces.counts = torch.full_like(spaces.counts, kept)
            label, spaces = _pass(points, spaces, threads)
    step = -(-(count - clusters) // _STEPS)
    while len(spaces.mean) > clusters:
        spaces = _without(spaces, missed_least(points, spaces, min(step, len(spaces.mean) - clusters), threads))
        for _ in range(_STEP_PASSES):
            label, spaces = _pass(points, spaces, threads)
    best, least = label, spaces.error()
    for _ in range(_LAST * iterations):
        former = spaces.error()
        label, spaces = _pass(points, spaces, threads)
        if spaces.error() < least:
            best, least = label, spaces.error()
        if former - spaces.error() <= _SETTLED * former:
            break
    return best


def _pass(points: Tensor, spaces: Subspaces, threads: int) -> tuple[Tensor, Subspaces]:
    clusters, rows, _ = spaces.basis.shape
    label, error = classify(points, spaces, threads)
    label = fill_empty(label, error, clusters)
    return label, fit(points, label, clusters, rows)


def missed_least(points: Tensor, spaces: Subspaces, most: int, threads: int) -> Tensor:
    """Up to `most` clusters whose points lose least by going to the second nearest, in that order; at least one.

    The one that takes in most of the points of a dropped cluster is not dropped with it.
    """
    clusters = len(spaces.mean)
    label, other, further = runners_up(points, spaces, threads)
    cost = torch.zeros_like(spaces.spread).index_add_(0, label, further.double())
    pairs, count = (label * clusters + other).unique(return_counts=True)
    order = count.argsort(stable=True)
    heirs = dict(zip((pairs[order] // clusters).tolist(), (pairs[order] % clusters).tolist(), strict=True))
    dropped: dict[int, None] = {}
    needed: set[int] = set()
    for cluster in cost.argsort(stable=True).tolist():
        if cluster not in needed and len(dropped) < most and heirs.get(cluster) not in dropped:
            dropped[cluster] = None
            needed.add(heirs.get(cluster, cluster))
    return torch.tensor(list(dropped), device=label.device)


def _without(spaces: Subspaces, dropped: Tensor) -> Subspaces:
    kept = torch.ones(len(spaces.mean), dtype=torch.bool, device=dropped.device)
    kept[dropped] = False
    return Subspaces(*(getattr(spaces, field.name)[kept] for field in fields(spaces)))


def adapt(
    points: Tensor, label: Tensor, clusters: int, components: int, iterations: int, threads: int
) -> tuple[Tensor, Tensor]:
    """Labels and numbers of PCA vectors `[K]` after passes of classification, PCA and handing out.

    The best of all states, also of that at the start: passes need not lower the error.
    Source: Sloan et al. 2003, section 4.3.
    """
    rows = min(points.shape[1], 4 * components + 4)
    spaces = fit(points, label, clusters, rows)
    spaces.counts = torch.full_like(spaces.counts, min(components, rows))
    best, least = (label, spaces.counts), spaces.error()
    for _ in range(iterations):
        spaces.counts = hand_out(spaces, components)
        if spaces.error() < least:
            best, least = (label, spaces.counts), spaces.error()
        label, error = classify(points, spaces, threads)
        label = fill_empty(label, error, clusters)
        spaces = fit(points, label, clusters, rows)
    return best


def hand_out(spaces: Subspaces, components: int) -> Tensor:
    """PCA vectors of every cluster, `[K]`: no more weights in all than with `components` in every cluster.

    Vector i of cluster k removes the squared error D_i^2 for a weight in each of m_k points; vectors are taken in the
    order of D_i^2 / m_k until the weights are spent.
    """
    clusters, rows = spaces.energy.shape
    cost = spaces.sizes.clamp(min=1)
    rate = (spaces.energy / cost[:, None]).flatten()
    order = rate.argsort(descending=True, stable=True)
    spent = cost.repeat_interleave(rows)[order].cumsum(0)
    taken = order[(spent <= components * spaces.sizes.sum()) & (rate[order] > 0)]
    return torch.bincount(taken // rows, minlength=clusters)
