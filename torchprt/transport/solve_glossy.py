"""Transport over all receivers where some are glossy: diffuse and glossy from one set of traced rays."""

from __future__ import annotations

import math
from dataclasses import dataclass

from torch import Tensor

from torchprt.transfer.pieces import rows
from torchprt.transport.glossy import Exitant
from torchprt.transport.glossy_tasks import GlossyBounce, GlossyJob, GlossyTrace, Recorded
from torchprt.transport.mirrors import mean_cut
from torchprt.transport.stages import Stages
from torchprt.transport.tables import Tables, in_channels
from torchprt.transport.task import chunks


@dataclass
class Arrived:
    """Diffuse vectors `[V, C * N]` and matrices `[G, R, C * N]`, receivers first."""

    diffuse: Tensor
    matrix: Tensor

    def add_(self, other: Arrived) -> None:
        """Adds what arrived beside it, in place."""
        self.diffuse.add_(other.diffuse)
        self.matrix.add_(other.matrix)

    def norm(self) -> float:
        return math.hypot(float(self.diffuse.norm()), float(self.matrix.norm()))


@dataclass
class GlossySolution:
    """What `arrived` at all receivers (without what shines through membranes), what the last bounce gathered, and what
    was `cut` off among mirrors."""

    arrived: Arrived
    exitant: Exitant | None = None
    bounces: int = 0
    cut: float | None = None


def solve(task: GlossyJob, bounces: int | float, stages: Stages) -> GlossySolution:
    """Traces every chunk once and follows its hits for `bounces`; they need a store."""
    recorded: tuple[Recorded, ...] = ("wanted",)
    if bounces and not task.recording.bounces_alike:
        # What surfaces are shaded from when they are hit comes first.
        recorded = ("for hits", "wanted")
    alone, cut = _trace(task, recorded, stages, keep_hits=bounces > 0)
    if not bounces:
        return GlossySolution(alone[0], cut=cut)
    tables = stages.tables
    direct = [repeated(each, task.job.channels // task.job.surfaces.channels, tables) for each in alone]
    total, count = direct[0], 0
    if len(recorded) > 1:
        # Recordings share what is diffuse, and bounces are added in place.
        total = Arrived(tables.empty(*direct[0].diffuse.shape), direct[0].matrix)
        total.diffuse.copy_(direct[0].diffuse)
    added = total
    while count < bounces:
        sent = exitant(task, total, stages)
        if len(recorded) > 1 and count == bounces - 1:
            break
        source = sent if added is total else exitant(task, added, stages)
        added = _bounce(task, source, recorded[0], stages, count + 1)
        del source
        if bounces == math.inf and not count and not added.norm():
            # Nothing that rays meet reflects, as around a convex body: none of the bounces is one, nor has it colour.
            return GlossySolution(alone[-1], cut=cut)
        total.add_(added)
        count += 1
        if bounces == math.inf and added.norm() <= task.job.enough * total.norm():
            break
    if len(recorded) == 1:
        return GlossySolution(total, sent, count, cut)
    # One more gather, into the rows that are wanted.
    sent = exitant(task, total, stages)
    last = _bounce(task, sent, recorded[1], stages, count + 1)
    direct[1].add_(last)
    return GlossySolution(direct[1], sent, count + 1, cut)


def exitant(task: GlossyJob, arrived: Arrived, stages: Stages) -> Exitant:
    """What all receivers send out of what arrived."""
    channels = task.job.channels
    albedo, specular = _widths(task.albedo, channels), _widths(task.specular, channels)
    columns = arrived.diffuse.shape[1] // channels
    leaving = task.job.through(arrived.diffuse, stages)
    count, height, width = arrived.matrix.shape
    table = stages.tables.empty(len(leaving) + count * height, width)
    for some in rows(*leaving.shape):
        table[some] = leaving[some] * albedo[some].repeat_interleave(columns, 1)
    matrix = table[len(leaving) :].view(count, height, width)
    for some in rows(count, height * width):
        matrix[some] = arrived.matrix[some] * specular[some].repeat_interleave(columns, 1)[:, None]
    return Exitant(table, math.isqrt(height))


def _widths(weights: Tensor, channels: int) -> Tensor:
    return weights[:, :1] if channels == 1 else weights.expand(-1, 3)


def _trace(
    task: GlossyJob, recorded: tuple[Recorded, ...], stages: Stages, *, keep_hits: bool
) -> tuple[list[Arrived], float | None]:
    """Direct light of every chunk, one for each recording; the diffuse part belongs to all. And what was cut off."""
    job, glossy = task.job, task.glossy
    channels = job.surfaces.channels
    tasks = [GlossyTrace(each, job.rays, job.seed, recorded, keep_hits) for each in chunks(len(job.receivers))]
    diffuse = stages.tables.empty(len(job.receivers), channels * job.order**2)
    recordings = [task.recording_of(each) for each in recorded]
    matrices = [stages.tables.empty(len(glossy.receivers), r.count, channels * r.columns) for r in recordings]
    cut: list[float] = []
    for chunk, found in stages.run("trace", tasks, task, first=0):
        diffuse[chunk.index] = found["transfer"].permute(2, 0, 1).flatten(1)
        cut += found["cut"].tolist() if "cut" in found else []
        for number, matrix in enumerate(matrices):
            matrix[glossy.among(chunk.index)] = found[f"matrix{number}"]
    job.filled(diffuse)
    for matrix in matrices:
        task.filled(matrix)
    return [Arrived(diffuse, matrix) for matrix in matrices], mean_cut(cut)


def repeated(arrived: Arrived, times: int, tables: Tables) -> Arrived:
    """The same in more channels; itself in as many."""
    return Arrived(in_channels(arrived.diffuse, times, tables), in_channels(arrived.matrix, times, tables))


def _bounce(task: GlossyJob, sent: Exitant, recorded: Recorded, stages: Stages, bounce: int) -> Arrived:
    job, width = task.job, sent.table.shape[1]
    tasks = [
        GlossyBounce(each, job.rays, job.seed, recorded, number)
        for number, each in enumerate(chunks(len(job.receivers)))
    ]
    matrix = stages.tables.empty(len(task.glossy.receivers), task.recording_of(recorded).count, width)
    added = Arrived(stages.tables.empty(len(job.receivers), width), matrix)
    for chunk, found in stages.run(f"bounce {bounce}", tasks, task, sent, stages.store):
        added.diffuse[chunk.index] = found["arriving"]
        added.matrix[task.glossy.among(chunk.index)] = found["matrix"]
    job.filled(added.diffuse)
    task.filled(added.matrix)
    return added
