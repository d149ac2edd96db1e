"""How many clusters, weights and shared axes: what reaches an error in the fewest bytes, or the least error in some."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torchprt.compression.clustering_data import DIMENSIONS, check, normalised
from torchprt.compression.clusters import quantise
from torchprt.compression.importance import root_of, weighed
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.shared_axes import moments
from torchprt.compression.subspaces import Advance, classify, fill_empty, fit, one_thread

# Points that stand for all of them, fewer if they are wide; clusters are as many fewer, so that a cluster has as many.
_SAMPLE, _WIDE_SAMPLE = 1 << 15, 1 << 14
_LEAST_CLUSTERS, _MOST_CLUSTERS = 1 << 4, 1 << 11
_MOST_COMPONENTS = 40
_SHARED = (32, 64, 96, 128, 192, 256, 320, 384, 448, 512)
# So many numbers of clusters that are worse than a smaller one say that more of them are.
_WORSE = 2
# Passes of vector quantisation, and after them with so many components: more of these than with 1, 2, 4, ...
_START, _EACH = 4, 2
_LEVELS, _WIDE_LEVELS = (1, 2, 4, 8, 16, 32), (4, 16)
# Of an error that the axes alone seem to explain, clusters leave at least this part.
_LEAST_LEFT = 0.3
# Squared rounding of half-precision representatives, of their square.
_HALF = 2.0**-24 / 3


@dataclass(frozen=True)
class Sizes:
    """A size of clustered PCA: `bytes` are exact, `error` (relative RMS) is expected.

    Squared, relative to the power: `clustered` is what clusters and weights are expected to leave, `cut` what no
    point reaches because the shared axes do not.
    """

    clusters: int
    components: int
    shared: int
    bytes: int
    clustered: float
    cut: float

    @property
    def error(self) -> float:
        # Of what clusters leave over, a part is what the axes leave out.
        return (self.clustered**1.5 + self.cut**1.5) ** (1 / 3)


def stored_bytes(points: int, numbers: int, clusters: int, components: int, shared: int, bits: int) -> int:
    """Bytes of clustered transfer with as many PCA vectors in every cluster."""
    label = 1 if clusters <= 1 << 8 else 2 if clusters <= 1 << 15 else 4
    weight, value = bits // 8, 4 if bits == 32 else 2
    width = shared or numbers
    ranges = 8 * clusters * components if bits == 8 else 0
    representatives = value * (clusters * (components + 1) * width + shared * numbers)
    return points * (label + weight * components) + representatives + 4 * (clusters + 1) + ranges


def candidates(
    signal: Tensor,
    limit: int,
    *,
    method: str,
    bits: int,
    seed: int,
    passes: Passes,
    importance: Tensor | None = None,
    points: int | None = None,
    error: float | None = None,
) -> list[Sizes]:
    """Every size that is sought among, its error foretold from a sample of points.

    Of more and more clusters; `error`: no more once twice as many, and twice again, reach it in more bytes only.

    `signal [V, S]`, all points or a sample that stands for so many `points`; sizes of more than `limit` bytes are
    foretold less well, or left out. Shared axes are sought where a point has more numbers than there are dimensions
    that clusters are sought in. Raises InputError as `clustered_pca`.
    """
    check(signal, 1, 1)
    numbers = signal.shape[1]
    points = len(signal) if points is None else points
    wide = numbers > DIMENSIONS
    sample = signal[:: -(-len(signal) // (_WIDE_SAMPLE if wide else _SAMPLE))]
    found: list[Sizes] = []
    with torch.no_grad(), one_thread():
        root = None if importance is None else root_of(importance, signal)
        metric = sample if root is None else weighed(sample, root)
        spectrum = torch.linalg.eigvalsh(moments(metric)).flip(0).clamp(min=0)
        power = float(spectrum.sum()) or 1.0
        left = (1 - spectrum.cumsum(0) / power).clamp(min=0).tolist()
        shares = [0, *(count for count in _SHARED if count < numbers)] if wide else [0]
        data = normalised(metric)

        def fits(clusters: int, components: int) -> bool:
            width = DIMENSIONS if wide else 0
            return stored_bytes(points, numbers, clusters, components, width, bits) <= limit

        known = _WIDE_LEVELS if wide else _LEVELS
        tried = {
            clusters: [level for level in known if level <= data.shape[1] and fits(clusters, level)]
            for clusters in _clusters(points, method)
            if clusters == 1 or fits(clusters, 0)
        }

        def sizes(clusters: int, curve: Tensor) -> list[Sizes]:
            most = 0 if method == "vq" else min(len(curve) - 1, numbers)
            return [
                Sizes(
                    clusters,
                    components,
                    shared,
                    stored_bytes(points, numbers, clusters, components, shared, bits),
                    squared,
                    left[shared - 1] if shared else 0.0,
                )
                for components, squared in enumerate((curve[: most + 1] / power).tolist())
                for shared in shares
            ]

        fewest: list[float] = []

        def enough(clusters: int, curve: Tensor) -> bool:
            if error is None:
                return False
            reaching = [size.bytes for size in sizes(clusters, curve) if size.error <= error]
            fewest.append(min(reaching, default=math.inf))
            return len(fewest) > _WORSE and min(fewest[-_WORSE:]) > min(fewest)

        curves = _curves(data, metric, tried, len(sample) / points, method, bits, seed, passes, enough)
        for clusters, curve in curves.items():
            found += sizes(clusters, curve)
    return found


def _clusters(points: int, method: str) -> Iterator[int]:
    yield 1
    clusters = _LEAST_CLUSTERS
    while method != "pca" and clusters <= min(_MOST_CLUSTERS, points // 4):
        yield clusters
        clusters *= 2


def _curves(
    data: Tensor,
    metric: Tensor,
    tried: dict[int, list[int]],
    part: float,
    method: str,
    bits: int,
    seed: int,
    passes: Passes,
    enough: Callable[[int, Tensor], bool],
) -> dict[int, Tensor]:
    """The curve of every number of clusters that is `tried`, at these levels, from a `part` of all points.

    Until one is `enough`, of which all are asked in turn.
    """
    refined = method in ("iterative", "adaptive")
    each = {clusters: _START + _EACH * len(levels) * (refined and clusters > 1) for clusters, levels in tried.items()}
    with passes.stage("sampling", sum(each.values()), len(data)) as stage:
        curves = stage.kept
        for number, (clusters, levels) in enumerate(tried.items()):
            if str(clusters) in curves:
                if enough(clusters, curves[str(clusters)]):
                    break
                continue
            fewer = max(1, round(clusters * part))
            label = quantise(data, fewer, seed, _START, passes.within(stage))
            wanted = levels if refined and fewer > 1 else []
            curves[str(clusters)] = _curve(data, metric, label, fewer, wanted, bits, passes, stage.advance)
            over = enough(clusters, curves[str(clusters)])
            stage.keep(curves, passes=each[clusters], last=over or number == len(tried) - 1)
            if over:
                break
    return {clusters: curves[str(clusters)] for clusters in tried if str(clusters) in curves}


def _curve(
    data: Tensor,
    metric: Tensor,
    label: Tensor,
    clusters: int,
    levels: list[int],
    bits: int,
    passes: Passes,
    advance: Advance,
) -> Tensor:
    """Squared error of `metric` with 0, 1, 2, ... components, `[R + 1]`; clusters are sought in `data`.

    Clusters that are best for some components are not for others: they are sought at every level, and each says what is
    left with about as many.
    """
    rows = min(metric.shape[1], _MOST_COMPONENTS)
    curve = _left(fit(metric, label, clusters, rows), bits)
    for level in levels:
        for _ in range(_EACH):
            spaces = fit(data, label, clusters, level)
            label, error = classify(data, spaces, passes.threads, advance)
            label = fill_empty(label, error, clusters)
        first = max(1, round(level / math.sqrt(2)))
        # Never worse than what fewer passes found.
        curve[first:] = torch.minimum(curve, _left(fit(metric, label, clusters, rows), bits))[first:]
    return curve


def _left(spaces: Subspaces, bits: int) -> Tensor:
    """Squared error with 0, 1, 2, ... components, rounding included."""
    removed = torch.cat([spaces.energy.new_zeros(len(spaces.mean), 1), spaces.energy.cumsum(1)], 1)
    squared = (spaces.spread[:, None] - removed).clamp(min=0)
    if bits < 32:
        squared = squared + _HALF * (spaces.spread + spaces.sizes * spaces.mean.square().sum(1))[:, None]
    if bits == 8:
        # m normal weights of deviation 1 lie within 2 sqrt(2 ln m); in 255 steps the rounding is a step / sqrt(12).
        reach = 8 * spaces.sizes.clamp(min=2).double().log()
        squared = squared + removed * (reach / (12 * 255**2))[:, None]
    return squared.sum(0)


def corrected(sizes: list[Sizes], tried: Sizes, error: float) -> list[Sizes]:
    """`sizes` after `tried` turned out to have `error`: what clusters leave in the same proportion.

    What the axes cut is known, and no clusters bring it back.
    """
    clustered = max(error**3 - tried.cut**1.5, (_LEAST_LEFT * error) ** 3) ** (2 / 3)
    factor = clustered / tried.clustered if tried.clustered > 0 else 1.0
    return [replace(each, clustered=each.clustered * factor) for each in sizes]
