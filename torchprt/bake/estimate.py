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
SAMPLE, SAMPLE_RAYS = 64, 16


def error_and_signal(
    job: Job, transfer: Float[Tensor, "C N V"], exitant: Tensor | None, workers: Workers, report: Report
) -> tuple[float | None, float | None]:
    """RMS error of a coefficient, from a spread of receivers, and RMS of a coefficient over all receivers.

    16 times the rays leave about an eighth of the error, so the estimate is right to a few percent plus the chance
    of the sample. With bounces it holds the last gather; earlier ones share the same relative error.
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

    def square(row: Tensor) -> float:
        better = gathered(finer, row, exitant, directions, project)
        return float((transfer[:, :, row] - better).double().square().mean())

    report.start("error", count * finer.rays)
    squares = []
    for value in workers.map(square, list(alive[order[:count]].split(1))):
        squares.append(value)
        report.advance(finer.rays)
    # An exact sum: it must not depend on which thread came first.
    total = math.fsum(squares)
    signal = math.sqrt(float(transfer[:, :, alive].double().square().mean()))
    return math.sqrt(total / count), signal
