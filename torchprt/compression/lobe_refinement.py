"""Axes of lobes moved to where the error is least, by Levenberg-Marquardt steps for many vectors at once."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import torch
from torch import Tensor

from torchprt.compression.lobe_axes import Fit, Target, evaluate, slopes_of
from torchprt.compression.small_systems import backward, cholesky, forward

# Vectors at a time: their arrays fit in the cache of a core. A part of the bits of the result, so not a parameter.
CHUNK = 1 << 12
# Damping, relative to the diagonal of the curvature: where it begins, how it changes, and where a vector is given up.
_START, _FALL, _RISE, _LEAST, _MOST = 1e-2, 0.2, 5.0, 1e-7, 1e4
# Chunks are packed anew when so much of them is done.
_DONE = 0.3


class Workers:
    """Chunks of a target on so many threads: torch itself is on one, so that a chunk has the same bits everywhere."""

    def __init__(self, threads: int) -> None:
        self.threads = threads

    def map(self, work: Any, count: int) -> list[Any]:
        """`work(rows)` for every chunk of `count` vectors, in order."""
        rows = [slice(first, min(first + CHUNK, count)) for first in range(0, max(count, 1), CHUNK)]
        with ThreadPoolExecutor(self.threads) as pool:
            return list(pool.map(torch.no_grad()(work), rows))


def refine(
    target: Target, axes: Tensor, workers: Workers, *, iterations: int, tolerance: float
) -> tuple[Tensor, Tensor]:
    """Axes `[L, 3, V]` from `axes` downhill, and what is then sought `[V]`, less the power of the vectors.

    A vector is done when a step promises less than `tolerance` of what is left, or after so many `iterations`. What is
    sought never rises, beyond rounding.
    """

    def work(rows: slice) -> tuple[Tensor, Tensor]:
        return _refine(target[rows], axes[..., rows], iterations, tolerance)

    parts = workers.map(work, len(target))
    return torch.cat([part[0] for part in parts], -1), torch.cat([part[1] for part in parts])


def _refine(target: Target, axes: Tensor, iterations: int, tolerance: float) -> tuple[Tensor, Tensor]:
    power = target.vectors.square().sum((0, 1))
    # An error is known to its rounding, a slope to the square root of what it promises.
    eps = torch.finfo(power.dtype).eps
    rounding, least = 32 * eps * power, (4 * eps) ** 2 * power
    slopes = slopes_of(target)
    fit = evaluate(target, slopes, axes)
    damping = torch.full_like(power, _START)
    found, error = axes.clone(), torch.empty_like(power)
    index = torch.arange(len(target), device=axes.device)
    for _ in range(iterations):
        step, promised = _step(fit, damping)
        tried = evaluate(target, slopes, _moved(fit, step))
        better = tried.error <= fit.error + rounding
        small = (promised <= tolerance * (power + fit.error).clamp(min=0) + least) & promised.isfinite()
        damping = torch.where(better, damping * _FALL, damping * _RISE).clamp(min=_LEAST)
        fit = tried.where(better, fit)
        done = small | (damping > _MOST)
        if done.all():
            break
        if done.float().mean() > _DONE:
            found[..., index[done]], error[index[done]] = fit.axes[..., done], fit.error[done]
            kept = (~done).nonzero()[:, 0]
            target, fit, slopes = target[kept], fit[kept], [part[..., kept] for part in slopes]
            index, power, rounding, least, damping = (part[kept] for part in (index, power, rounding, least, damping))
    found[..., index], error[index] = fit.axes, fit.error
    return found, error


def _step(fit: Fit, damping: Tensor) -> tuple[Tensor, Tensor]:
    """The step `[2 L, V]` along the tangents, zero where there is none, and the decrease that it promises `[V]`."""
    matrix = fit.curvature.clone()
    diagonal = matrix.diagonal().movedim(-1, 0)
    scale = diagonal.clamp(min=0)
    # A lobe without height has no curvature, and nowhere to go.
    diagonal += damping * (scale + 1e-4 * scale.amax(0)) + torch.finfo(matrix.dtype).tiny
    factor = cholesky(matrix)
    half = forward(factor, fit.slope)
    step = backward(factor, half)
    return torch.where(step.isfinite().all(0), step, 0.0), half.square().sum(0)


def _moved(fit: Fit, step: Tensor) -> Tensor:
    moved = fit.axes + (fit.tangents * step.unflatten(0, (2, 1, -1))).sum(0).movedim(0, 1)
    return moved / torch.linalg.vector_norm(moved, dim=1, keepdim=True)
