"""How many clusters, weights and shared axes: what reaches an error in the fewest bytes, or the least error in some."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from torchprt.compress.clusters import quantise
from torchprt.compress.importance import root_of, weighed
from torchprt.compress.shared_axes import moments
from torchprt.compress.signal import DIMENSIONS, check, normalised
from torchprt.compress.subspaces import classify, fill_empty, fit, one_thread

# Points that stand for all of them; clusters are as many fewer, so that a cluster has as many points.
_SAMPLE = 1 << 13
_MOST_CLUSTERS = 1 << 12
_MOST_COMPONENTS = 48
_SHARED = (24, 32, 48, 64, 96, 128, 160, 192, 256, 320, 384)
# Passes with so many components, after vector quantisation of so many passes.
_PASSES, _START = (2, 4, 8), 6


@dataclass(frozen=True)
class Sizes:
    """A size of clustered PCA: `bytes` are exact, `error` (relative RMS) is expected."""

    clusters: int
    components: int
    shared: int
    bytes: int
    error: float


def stored_bytes(points: int, numbers: int, clusters: int, components: int, shared: int, bits: int) -> int:
    """Bytes of clustered transfer with as many PCA vectors in every cluster."""
    label = 1 if clusters <= 1 << 8 else 2 if clusters <= 1 << 15 else 4
    weight, value = bits // 8, 4 if bits == 32 else 2
    width = shared or numbers
    ranges = 8 * clusters * components if bits == 8 else 0
    representatives = value * (clusters * (components + 1) * width + shared * numbers)
    return points * (label + weight * components) + representatives + 4 * (clusters + 1) + ranges


def candidates(signal: Tensor, *, method: str, bits: int, seed: int, importance: Tensor | None = None) -> list[Sizes]:
    """Every size that is sought among, its error foretold from a sample of points.

    `signal [V, S]`. Shared axes are sought where a point has more numbers than there are dimensions clusters are
    sought in. Raises InputError as `clustered_pca`.
    """
    check(signal, 1, 1)
    points, numbers = signal.shape
    sample = signal[:: -(-points // _SAMPLE)]
    found: list[Sizes] = []
    with torch.no_grad(), one_thread() as threads:
        root = None if importance is None else root_of(importance, signal)
        metric = sample if root is None else weighed(sample, root)
        spectrum = torch.linalg.eigvalsh(moments(metric)).flip(0).clamp(min=0)
        power = float(spectrum.sum()) or 1.0
        lost = 1 - spectrum.cumsum(0) / power
        data = normalised(metric)
        # Squares of `data` are those of `metric` less what its axes leave out, in a unit of its own.
        inside = float((metric - metric.mean(0)).double().square().sum())
        unit = inside / (float(data.double().square().sum()) or 1.0)
        rest = max(0.0, 1.0 - float(_kept(metric, data.shape[1]))) * inside if data.shape[1] < numbers else 0.0
        shares = [0, *(count for count in _SHARED if count < numbers)] if numbers > DIMENSIONS else [0]
        for clusters in _clusters(points, method):
            curve = _curve(data, max(1, round(clusters * len(sample) / points)), method, seed, threads)
            for components in range(min(len(curve) - 1, numbers, 0 if method == "vq" else numbers) + 1):
                squared = (float(curve[components]) * unit + rest * bool(components < numbers)) / power
                for shared in shares:
                    total = squared
                    if shared:
                        # Of what clusters leave over, a part is what the axes leave out.
                        total = (squared**1.5 + max(0.0, float(lost[shared - 1])) ** 1.5) ** (2 / 3)
                    size = stored_bytes(points, numbers, clusters, components, shared, bits)
                    found.append(Sizes(clusters, components, shared, size, math.sqrt(max(total, 0.0))))
    return found


def _kept(metric: Tensor, count: int) -> float:
    centred = metric.double() - metric.double().mean(0)
    values = torch.linalg.eigvalsh(moments(centred)).flip(0).clamp(min=0)
    return float(values[:count].sum() / (values.sum() or 1.0))


def _clusters(points: int, method: str) -> Iterator[int]:
    clusters = 1
    while clusters <= (1 if method == "pca" else min(_MOST_CLUSTERS, max(1, points // 4))):
        yield clusters
        clusters *= 2


def _curve(data: Tensor, clusters: int, method: str, seed: int, threads: int) -> Tensor:
    """Squared error with 0, 1, 2, ... components, `[R + 1]`."""
    rows = min(data.shape[1], _MOST_COMPONENTS)
    label = quantise(data, clusters, seed, _START, threads)
    if clusters > 1 and method in ("iterative", "adaptive"):
        for components in _PASSES:
            spaces = fit(data, label, clusters, min(components, rows))
            label, error = classify(data, spaces, threads)
            label = fill_empty(label, error, clusters)
    spaces = fit(data, label, clusters, rows)
    energy = spaces.energy.sum(0)
    left = spaces.spread.sum() - torch.cat([energy.new_zeros(1), energy.cumsum(0)])
    return left.clamp(min=0)


def corrected(sizes: list[Sizes], tried: Sizes, error: float) -> list[Sizes]:
    """`sizes` after `tried` turned out to have `error`: all errors in the same proportion."""
    factor = error / tried.error if tried.error > 0 else 1.0
    return [Sizes(s.clusters, s.components, s.shared, s.bytes, s.error * factor) for s in sizes]
