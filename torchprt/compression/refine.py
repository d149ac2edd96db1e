"""Better clusters for the same numbers: classified by approximation error, PCA vectors where they gain most."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import torch
from torch import Tensor

from torchprt.compression.resumable_passes import Passes, Stage
from torchprt.compression.subspaces import Advance, Subspaces, classify, fill_empty, fit, runners_up, silent

# Clusters to begin with, in multiples of those to end with; those missed least are dropped in so many steps, with so
# many passes after each, and at the end up to so many times the passes that a component takes.
_SURPLUS = 2
_STEPS = 3
_STEP_PASSES = 1
_LAST = 6
# Less gained by a pass, relative: no further pass.
_SETTLED = 1e-3


def surplus(points: int, clusters: int) -> int:
    """How many clusters `grow` begins with."""
    return min(points, _SURPLUS * clusters)


@dataclass(frozen=True)
class Fitted:
    """Points in clusters and, once it is asked for, the subspace of `rows` dimensions of each."""

    points: Tensor
    label: Tensor
    clusters: int
    rows: int

    @cached_property
    def spaces(self) -> Subspaces:
        return fit(self.points, self.label, self.clusters, self.rows)

    def nearest(self, spaces: Subspaces, passes: Passes, stage: Stage) -> Fitted:
        """Every point in the cluster of the nearest of `spaces`."""
        label, error = classify(self.points, spaces, passes.threads, stage.advance)
        clusters = len(spaces.mean)
        return replace(self, label=fill_empty(label, error, clusters), clusters=clusters)


def grow(points: Tensor, label: Tensor, clusters: int, components: int, iterations: int, passes: Passes) -> Tensor:
    """Labels after passes of classification and PCA, from those of vector quantisation into `surplus` clusters.

    With 1, 2, ... `components` (Kambhatla and Leen 1997; Sloan et al. 2003, section 4.2), which avoids bad local
    minima; then with fewer and fewer clusters, until there are `clusters`: those are dropped whose points lose least
    without them, so that clusters end up where error is, which passes alone do not bring about.
    """
    fitted = Fitted(points, label, surplus(len(points), clusters), components)
    fitted = _with_components(fitted, iterations, passes)
    fitted = _without_surplus(fitted, clusters, passes)
    return _settled(fitted, iterations, passes)


def _with_components(fitted: Fitted, iterations: int, passes: Passes) -> Fitted:
    planned = fitted.rows * iterations
    with passes.stage("growing", planned, len(fitted.points)) as stage:
        fitted = replace(fitted, label=stage.kept["label"]) if stage.kept else fitted
        while stage.done < planned:
            counts = torch.full_like(fitted.spaces.counts, stage.done // iterations + 1)
            fitted = fitted.nearest(replace(fitted.spaces, counts=counts), passes, stage)
            stage.keep({"label": fitted.label})
    return fitted


def _without_surplus(fitted: Fitted, clusters: int, passes: Passes) -> Fitted:
    step = -(-(fitted.clusters - clusters) // _STEPS)
    # One to see which are missed least, then those of the rest.
    round_passes = 1 + _STEP_PASSES
    planned = -(-(fitted.clusters - clusters) // max(1, step)) * round_passes
    with passes.stage("dropping", planned, len(fitted.points)) as stage:
        if stage.kept:
            fitted = replace(fitted, label=stage.kept["label"], clusters=int(stage.kept["clusters"]))
        while fitted.clusters > clusters or stage.done % round_passes:
            spaces, begun = fitted.spaces, stage.done % round_passes != 0
            if not begun:
                most = min(step, fitted.clusters - clusters)
                spaces = _without(spaces, missed_least(fitted.points, spaces, most, passes.threads, stage.advance))
            fitted = fitted.nearest(spaces, passes, stage)
            state = {"label": fitted.label, "clusters": torch.tensor(fitted.clusters, device="cpu")}
            stage.keep(state, passes=1 if begun else 2)
    return fitted


def _settled(fitted: Fitted, iterations: int, passes: Passes) -> Tensor:
    """Labels of the best of all passes until they gain next to nothing."""
    planned = _LAST * iterations
    with passes.stage("refining", planned, len(fitted.points)) as stage:
        if stage.kept:
            fitted = replace(fitted, label=stage.kept["label"])
            best, least = stage.kept["best"], float(stage.kept["least"])
        else:
            best, least = fitted.label, fitted.spaces.error()
        while stage.done < planned:
            former = fitted.spaces.error()
            fitted = fitted.nearest(fitted.spaces, passes, stage)
            error = fitted.spaces.error()
            if error < least:
                best, least = fitted.label, error
            state = {"label": fitted.label, "best": best, "least": _number(least)}
            stage.keep(state, last=former - error <= _SETTLED * former)
    return best


def _number(value: float) -> Tensor:
    return torch.tensor(value, dtype=torch.float64, device="cpu")


def missed_least(points: Tensor, spaces: Subspaces, most: int, threads: int, advance: Advance = silent) -> Tensor:
    """Up to `most` clusters whose points lose least by going to the second nearest, in that order; at least one.

    The one that takes in most of the points of a dropped cluster is not dropped with it.
    """
    clusters = len(spaces.mean)
    label, other, further = runners_up(points, spaces, threads, advance)
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
    points: Tensor, label: Tensor, clusters: int, components: int, iterations: int, passes: Passes
) -> tuple[Tensor, Tensor]:
    """Labels and numbers of PCA vectors `[K]` after passes of classification, PCA and handing out.

    The best of all states, also of that at the start: passes need not lower the error.
    Source: Sloan et al. 2003, section 4.3.
    """
    rows = min(points.shape[1], 4 * components + 4)
    fitted = Fitted(points, label, clusters, rows)
    with passes.stage("adapting", iterations, len(points)) as stage:
        if stage.kept:
            fitted = replace(fitted, label=stage.kept["label"])
            best, least = (stage.kept["best"], stage.kept["counts"]), float(stage.kept["least"])
        else:
            spaces = fitted.spaces
            spaces = replace(spaces, counts=torch.full_like(spaces.counts, min(components, rows)))
            best, least = (label, spaces.counts), spaces.error()
        while stage.done < iterations:
            spaces = replace(fitted.spaces, counts=hand_out(fitted.spaces, components))
            error = spaces.error()
            if error < least:
                best, least = (fitted.label, spaces.counts), error
            fitted = fitted.nearest(spaces, passes, stage)
            stage.keep({"label": fitted.label, "best": best[0], "counts": best[1], "least": _number(least)})
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
