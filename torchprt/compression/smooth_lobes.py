"""Lobes that correspond from vertex to vertex, so that axes and coefficients can be interpolated."""

from __future__ import annotations

import torch
from torch import Tensor

from torchprt.compression.lobe_axes import Target, fit_heights
from torchprt.compression.lobe_refinement import Workers, refine
from torchprt.compression.single_lobe import linear_axis
from torchprt.progress import Report

# Pull of axes toward the mean of the neighbours', of the mean power of a vector; and that of heights.
SMOOTHNESS = 0.03
_HEIGHTS = 0.05
# Where the pull begins, by how much it falls from stage to stage, and the passes of a stage.
_FIRST, _FALL, PASSES = 3.0, 10**0.5, 6
# Of each pass, and of the heights at the start.
_STEPS, _RIDGE = 2, 1e-2


def stages(smoothness: float) -> list[float]:
    """The pulls of all stages; the last is `smoothness`."""
    pulls = [float(smoothness)]
    while pulls[0] * _FALL <= _FIRST:
        pulls.insert(0, pulls[0] * _FALL)
    return pulls


def smooth_lobes(
    signal: Tensor,
    lobes: int,
    first: int,
    edges: Tensor,
    workers: Workers,
    generator: torch.Generator,
    pulls: list[float],
    restarts: int,
    report: Report,
) -> tuple[Tensor, Tensor]:
    """Axes `[L, 3, V]` and heights `[L, C, B, V]` for vectors `signal [N, C, V]`.

    All start from axes that correspond: the first from the optimal linear one, the others the same everywhere. Then
    each is fitted with a pull toward the mean of its neighbours, which falls in stages. Heights are pulled too: where
    others would serve as well, they are those of the neighbours. Of `restarts` and one sets of axes to start from, the
    one is kept whose lobes reach the least of what is sought.
    """
    largest = signal[first * first :].abs().amax()
    vectors = signal / torch.where(largest > 0, largest, 1.0)
    vectors[: first * first] = 0
    power = vectors.square().sum((0, 1)).mean().sqrt()
    scale = torch.where(power > 0, power, 1.0)
    vectors, scale = vectors / scale, scale * torch.where(largest > 0, largest, 1.0)
    linear = linear_axis(signal.sum(1).T).T
    best: tuple[float, Tensor, Tensor] | None = None
    for _ in range(restarts + 1):
        axes = torch.randn(lobes, 3, 1, generator=generator, dtype=torch.float64, device="cpu").to(vectors)
        axes = torch.nn.functional.normalize(axes, dim=1).repeat(1, 1, vectors.shape[2])
        axes[0] = linear
        heights = _heights(Target(vectors, first, _RIDGE), axes, workers)
        for pull in pulls:
            for _ in range(PASSES):
                target = Target(vectors, first, _HEIGHTS, _mean(heights, edges), _mean(axes, edges), pull)
                axes, error = refine(target, axes, workers, iterations=_STEPS, tolerance=0.0)
                heights = _heights(target, axes, workers)
                report.advance(signal.shape[2])
        left = float(error.double().sum())
        if best is None or left < best[0]:
            best = left, axes, heights * scale
    assert best is not None
    return best[1:]


def _heights(target: Target, axes: Tensor, workers: Workers) -> Tensor:
    def work(rows: slice) -> Tensor:
        return fit_heights(target[rows], axes[..., rows])[0]

    return torch.cat(workers.map(work, len(target)), -1)


def _mean(values: Tensor, edges: Tensor) -> Tensor:
    """Of `values [..., V]` over the neighbours of every vertex; its own if it has none."""
    rows = values.flatten(0, -2).T
    count = torch.bincount(edges[:, 0], minlength=len(rows))
    total = torch.zeros_like(rows).index_add_(0, edges[:, 0], rows[edges[:, 1]])
    mean = torch.where(count[:, None] > 0, total / count.clamp(min=1)[:, None], rows)
    return mean.T.reshape(values.shape)
