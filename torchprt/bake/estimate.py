"""How far the finite number of rays is from the truth, measured."""

from __future__ import annotations

import dataclasses
import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.bake.progress import Report
from torchprt.bake.solve import Job, gathered
from torchprt.bake.workers import Workers

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
    alive = torch.nonzero(job.receivers.normals.abs().sum(-1) > 0)[:, 0]
    if len(alive) == 0:
        return None, None
    count = min(len(alive), max(8, min(SAMPLE, len(alive) // 512)))
    order = torch.randperm(len(alive), generator=torch.Generator().manual_seed(job.seed))
    # Another seed: the reference must not be a refinement of the same set.
    finer = dataclasses.replace(job, rays=SAMPLE_RAYS * job.rays, seed=job.seed + 1)
    directions, project = finer.directions()

    def squares(rows: Tensor) -> tuple[int, float]:
        better = gathered(finer, rows, exitant, directions, project)
        return len(rows), float((transfer[:, :, rows] - better).double().square().mean((0, 1)).sum())

    report.start("error", count * finer.rays)
    sums = []
    for done, value in workers.map(squares, alive[order[:count]].split(8)):
        sums.append(value)
        report.advance(done * finer.rays)
    # An exact sum: it must not depend on which thread came first.
    total = math.fsum(sums)
    # Receivers without a normal add nothing to the sum.
    size = transfer.shape[0] * transfer.shape[1] * len(alive)
    signal = float(torch.linalg.vector_norm(transfer, dtype=torch.float64)) / math.sqrt(size)
    return math.sqrt(total / count), signal
