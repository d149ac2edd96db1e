"""How far the finite number of rays is from the truth, measured on receivers that are traced again."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.progress import Report
from torchprt.transport.solve import Job, gathered
from torchprt.transport.solve_glossy import GlossyJob, GlossySolution, record
from torchprt.transport.workers import Workers

# Receivers that are traced again at most, and with how many times the rays.
SAMPLE, SAMPLE_RAYS = 64, 8


def error_and_signal(
    job: Job, transfer: Float[Tensor, "C N V"], exitant: Tensor | None, workers: Workers, report: Report
) -> tuple[float | None, float | None]:
    """RMS error of a coefficient, from a spread of receivers, and RMS of a coefficient over all receivers.

    8 times the rays leave about a fifth of the error, which makes the estimate two percent too large; the chance of
    the sample is more, some ten percent. With bounces it is of the last gather; earlier ones err alike.
    None, None if no receiver has a normal.
    """
    # Another seed: the reference must not be a refinement of the same set.
    finer = dataclasses.replace(job, rays=SAMPLE_RAYS * job.rays, seed=job.seed + 1)
    directions, project = finer.directions()

    def squares(rows: Tensor) -> float:
        better = gathered(finer, rows, exitant, directions, project)
        return float((transfer[:, :, rows] - better).double().square().mean((0, 1)).sum())

    everything = torch.arange(len(job.receivers))
    return _estimate(job, everything, squares, transfer, transfer.shape[0] * transfer.shape[1], workers, report)


def glossy_error_and_signal(
    task: GlossyJob, solution: GlossySolution, workers: Workers, report: Report
) -> tuple[float | None, float | None]:
    """RMS error of an entry of the matrices, and RMS of an entry over all glossy receivers; as `error_and_signal`."""
    job, matrix = task.job, solution.arrived.matrix
    if not len(matrix):
        return None, None
    set_of = task.tables(task.recording, rays=SAMPLE_RAYS * job.rays, seed=job.seed + 1)

    def squares(rows: Tensor) -> float:
        _, better = record(task, job.receivers[rows], task.glossy.material[rows], solution.exitant, set_of)
        return float((matrix[task.glossy.number[rows]] - better).double().square().mean((1, 2)).sum())

    return _estimate(job, task.glossy.receivers, squares, matrix, matrix[0].numel(), workers, report)


def _estimate(
    job: Job,
    candidates: Int[Tensor, "c"],
    squares: Callable[[Tensor], float],
    result: Tensor,
    size: int,
    workers: Workers,
    report: Report,
) -> tuple[float | None, float | None]:
    alive = candidates[job.receivers.normals[candidates].abs().sum(-1) > 0]
    if len(alive) == 0:
        return None, None
    count = min(len(alive), max(8, min(SAMPLE, len(alive) // 512)))
    order = torch.randperm(len(alive), generator=torch.Generator().manual_seed(job.seed))
    report.start("error", count * SAMPLE_RAYS * job.rays)
    sums = []

    def one(rows: Tensor) -> tuple[int, float]:
        return len(rows), squares(rows)

    for done, value in workers.map(one, alive[order[:count]].split(8)):
        sums.append(value)
        report.advance(done * SAMPLE_RAYS * job.rays)
    # An exact sum: it must not depend on which thread came first.
    total = math.fsum(sums)
    # Receivers without a normal add nothing to the sum.
    signal = float(torch.linalg.vector_norm(result, dtype=torch.float64)) / math.sqrt(size * len(alive))
    return math.sqrt(total / count), signal
