"""Better clusters for the same numbers: classified by approximation error, PCA vectors where they gain most."""

from __future__ import annotations

import torch
from torch import Tensor

from torchprt.compress.subspaces import Subspaces, classify, fill_empty, fit

# Passes with all components, in multiples of those with fewer.
_LAST = 4
# Less gained by a pass, relative: no further pass.
_SETTLED = 1e-4


def grow(points: Tensor, label: Tensor, clusters: int, components: int, iterations: int, threads: int) -> Tensor:
    """Labels after passes of classification and PCA with 1, 2, ... `components`, from those of vector quantisation.

    The best of all states, also of that at the start. Adding components one by one avoids bad local minima.
    Source: Kambhatla and Leen 1997; Sloan et al. 2003, section 4.2.
    """
    spaces = fit(points, label, clusters, components)
    best, least = label, spaces.error()
    for count in range(1, components + 1):
        former = float("inf")
        for _ in range(iterations if count < components else _LAST * iterations):
            spaces.counts = torch.full_like(spaces.counts, count)
            if former - spaces.error() <= _SETTLED * former < float("inf"):
                break
            former = spaces.error()
            label, error = classify(points, spaces, threads)
            label = fill_empty(label, error, clusters)
            spaces = fit(points, label, clusters, components)
            if spaces.error() < least:
                best, least = label, spaces.error()
    return best


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
