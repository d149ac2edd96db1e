"""How far the finite number of rays is from the truth, measured on receivers that are traced again."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.transfer.pieces import pieces
from torchprt.transport.diffuse_tasks import Job, Record
from torchprt.transport.glossy_tasks import GlossyJob, GlossyRecord
from torchprt.transport.solve_glossy import GlossySolution
from torchprt.transport.stages import Stages

# Receivers that are traced again at most, and with how many times the rays.
SAMPLE, SAMPLE_RAYS = 64, 8


def error_and_signal(
    job: Job, arriving: Float[Tensor, "V W"], exitant: Tensor | None, stages: Stages
) -> tuple[float | None, float | None]:
    """RMS error of a coefficient, from a spread of receivers, and RMS of a coefficient over all receivers.

    8 times the rays leave about a fifth of the error, which makes the estimate two percent too large; the chance of
    the sample is more, some ten percent. With bounces it is of the last gather; earlier ones err alike.
    None, None if no receiver has a normal.
    """
    alive, sample = _spread(job, torch.arange(len(job.receivers)))
    if not alive:
        return None, None
    tasks = [Record(rows, *_finer(job)) for rows in sample]
    sums = []
    for task, better in stages.run("error", tasks, job, exitant):
        finer = better["transfer"][: arriving.shape[1] // job.order**2]
        sums.append(_square(arriving[task.index] - finer.permute(2, 0, 1).flatten(1), (1,)))
    job.once.forget()
    return _figures(sums, sample, arriving, arriving.shape[1] * alive)


def glossy_error_and_signal(
    task: GlossyJob, solution: GlossySolution, stages: Stages
) -> tuple[float | None, float | None]:
    """RMS error of an entry of the matrices, and RMS of an entry over all glossy receivers; as `error_and_signal`.

    Of the vectors, and over all receivers, if none is glossy."""
    name, rows, number, arrived = "matrix", task.glossy.receivers, task.glossy.number, solution.arrived.matrix
    if not len(rows):
        rows = number = torch.arange(len(task.job.receivers))
        name, arrived = "transfer", solution.arrived.diffuse[:, None]
    alive, sample = _spread(task.job, rows)
    if not alive:
        return None, None
    tasks = [GlossyRecord(rows, *_finer(task.job)) for rows in sample]
    sums = []
    for some, better in stages.run("error", tasks, task, solution.exitant):
        difference = arrived[number[some.index]] - better[name].view(-1, *arrived.shape[1:])
        sums.append(_square(difference, (1, 2)))
    task.once.forget()
    return _figures(sums, sample, arrived, arrived[0].numel() * alive)


def _finer(job: Job) -> tuple[int, int]:
    """Rays and seed of the reference: another seed, because it must not be a refinement of the same set."""
    return SAMPLE_RAYS * job.rays, job.seed + 1


def _spread(job: Job, candidates: Int[Tensor, "c"]) -> tuple[int, list[tuple[int, ...]]]:
    """How many of the candidates have a normal, and some of those that see by their own rays, eight a task."""
    alive = candidates[job.receivers.normals[candidates].abs().sum(-1) > 0]
    if job.validity is not None:
        alive = alive[~torch.isin(alive, job.validity.rows)]
    count = min(len(alive), max(8, min(SAMPLE, len(alive) // 512)))
    order = torch.randperm(len(alive), generator=torch.Generator().manual_seed(job.seed))
    return len(alive), [tuple(rows.tolist()) for rows in alive[order[:count]].split(8)]


def _square(difference: Tensor, axes: tuple[int, ...]) -> float:
    """The mean square of a receiver, summed over receivers."""
    return float(difference.double().square().mean(axes).sum())


def _figures(sums: list[float], sample: list[tuple[int, ...]], result: Tensor, size: int) -> tuple[float, float]:
    """The error, and the signal of a result of `size` numbers at receivers that have a normal; others add nothing."""
    # An exact sum: it must not depend on which task came first.
    error = math.sqrt(math.fsum(sums) / sum(map(len, sample)))
    # Some at a time: the norm of all in float64 would be twice as large as they are.
    squares = [float(result[place].double().square().sum()) for place in pieces(result)]
    return error, math.sqrt(math.fsum(squares) / size)
