"""Transport over all receivers where some are glossy: diffuse and glossy from one set of traced rays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.progress import Report
from torchprt.transport.checkpoint import Checkpoint
from torchprt.transport.directions import hemisphere
from torchprt.transport.glossy import Arrivals, Exitant, Glossy, Tables, gathered, shadowed, tables
from torchprt.transport.receivers import Receivers
from torchprt.transport.rows import Recording
from torchprt.transport.solve import ENERGY, Job, every_chunk, kept
from torchprt.transport.workers import Workers, chunks


@dataclass
class GlossyJob:
    """What a glossy bake is made of: the job of all receivers, which of them are glossy, and what they record.

    `albedo [V, 1 or 3]`, `specular [G, 1 or 3]`: what surfaces that are hit reflect.
    """

    job: Job
    glossy: Glossy
    recording: Recording
    albedo: Float[Tensor, "V A"]
    specular: Float[Tensor, "G S"]

    def tables(self, recording: Recording, *, rays: int | None = None, seed: int | None = None) -> Tables:
        """Tables along the directions of the job, or along more of them."""
        job = self.job
        directions = hemisphere(rays or job.rays, job.seed if seed is None else seed)
        return tables(directions, job.order, recording, self.glossy.brdfs)


@dataclass
class Arrived:
    """Diffuse vectors `[V, C * N]` and matrices `[G, R, C * N]`, receivers first."""

    diffuse: Tensor
    matrix: Tensor

    def norm(self) -> float:
        return math.hypot(float(self.diffuse.norm()), float(self.matrix.norm()))


@dataclass
class GlossySolution:
    """What `arrived` at all receivers (without what shines through membranes), and what the last bounce gathered."""

    arrived: Arrived
    exitant: Exitant | None = None
    bounces: int = 0


def solve(
    task: GlossyJob, bounces: int | float, store: Checkpoint | None, workers: Workers, report: Report
) -> GlossySolution:
    """Traces every chunk once and follows its hits for `bounces`; they need a `store`."""
    recordings = [task.recording]
    if bounces and not task.recording.bounces_alike:
        # What surfaces are shaded from when they are hit comes first.
        recordings.insert(0, task.recording.for_hits())
    direct = _trace(task, recordings, store, workers, report, keep_hits=bounces > 0)
    if not bounces:
        return GlossySolution(direct[0])
    assert store is not None
    set_of = task.tables(recordings[0])
    total, added, count = direct[0], direct[0], 0
    while count < bounces:
        sent = exitant(task, total)
        if len(recordings) > 1 and count == bounces - 1:
            break
        added = _bounce(task, exitant(task, added), recordings[0], set_of, store, workers, report, count + 1)
        total = Arrived(total.diffuse + added.diffuse, total.matrix + added.matrix)
        count += 1
        if bounces == math.inf and added.norm() <= ENERGY * total.norm():
            break
    if len(recordings) == 1:
        return GlossySolution(total, sent, count)
    # One more gather, into the rows that are wanted.
    sent = exitant(task, total)
    last = _bounce(task, sent, recordings[1], task.tables(recordings[1]), store, workers, report, count + 1)
    arrived = Arrived(direct[1].diffuse + last.diffuse, direct[1].matrix + last.matrix)
    return GlossySolution(arrived, sent, count + 1)


def exitant(task: GlossyJob, arrived: Arrived) -> Exitant:
    """What all receivers send out of what arrived."""
    channels = task.job.channels
    albedo, specular = _widths(task.albedo, channels), _widths(task.specular, channels)
    columns = arrived.diffuse.shape[1] // channels
    diffuse = task.job.through(arrived.diffuse) * albedo.repeat_interleave(columns, 1)
    matrix = arrived.matrix * specular.repeat_interleave(columns, 1)[:, None]
    return Exitant(torch.cat([diffuse, matrix.flatten(0, 1)]), math.isqrt(arrived.matrix.shape[1]))


def _widths(weights: Tensor, channels: int) -> Tensor:
    return weights[:, :1] if channels == 1 else weights.expand(-1, 3)


def _trace(
    task: GlossyJob,
    recordings: list[Recording],
    store: Checkpoint | None,
    workers: Workers,
    report: Report,
    *,
    keep_hits: bool,
) -> list[Arrived]:
    """Direct light of every chunk, one for each recording; the diffuse part belongs to all."""
    job, channels = task.job, task.job.channels
    everything = chunks(len(job.receivers))
    sets = [task.tables(recording) for recording in recordings]
    diffuse = torch.empty(len(job.receivers), job.order**2)
    matrices = [torch.empty(len(task.glossy.receivers), r.count, r.columns) for r in recordings]

    def one(index: int) -> dict[str, Tensor]:
        rows = everything[index]
        part, found, arrivals = shadowed(
            job.tracer,
            job.surfaces,
            job.receivers[rows],
            task.glossy.material[rows],
            sets[0],
            *(each.rows for each in sets[1:]),
            keep_hits=keep_hits,
        )
        contents = {f"matrix{number}": matrix for number, matrix in enumerate(found)}
        return {"transfer": part, **contents, **({} if arrivals is None else vars(arrivals))}

    def take(index: int, contents: dict[str, Tensor]) -> None:
        diffuse[everything[index]] = contents["transfer"].T
        for number, matrix in enumerate(matrices):
            matrix[_numbers(task.glossy, everything[index])] = contents[f"matrix{number}"]

    every_chunk(len(job.receivers), job.rays, one, take, store, workers, report)
    return [Arrived(diffuse.repeat(1, channels), matrix.repeat(1, 1, channels)) for matrix in matrices]


def _numbers(everything: Glossy, rows: slice) -> slice:
    """The glossy receivers among `rows`: neighbours, because they ascend."""
    start, stop = torch.searchsorted(everything.receivers, torch.tensor([rows.start, rows.stop])).tolist()
    return slice(start, stop)


def _bounce(
    task: GlossyJob,
    sent: Exitant,
    recording: Recording,
    set_of: Tables,
    store: Checkpoint,
    workers: Workers,
    report: Report,
    number: int,
) -> Arrived:
    job = task.job
    everything = chunks(len(job.receivers))
    width = sent.table.shape[1]
    added = Arrived(
        torch.empty(len(job.receivers), width), torch.empty(len(task.glossy.receivers), recording.count, width)
    )

    def one(index: int) -> tuple[int, Tensor, Tensor]:
        rows = everything[index]
        contents = kept(store, index)
        arrivals = Arrivals(**{name: contents[name] for name in Arrivals.__dataclass_fields__})
        material = task.glossy.material[rows]
        return index, *gathered(arrivals, sent, task.glossy, job.surfaces, job.receivers[rows], material, set_of)

    report.start(f"bounce {number}", len(job.receivers))
    for index, diffuse, matrix in workers.map(one, range(len(everything))):
        added.diffuse[everything[index]] = diffuse
        added.matrix[_numbers(task.glossy, everything[index])] = matrix
        report.advance(len(diffuse))
    return added


def record(
    task: GlossyJob,
    receivers: Receivers,
    material: Tensor,
    sent: Exitant | None,
    set_of: Tables,
) -> tuple[Float[Tensor, "v W"], Float[Tensor, "g R _"]]:
    """Direct light and one gather of any receivers, traced anew: for points, and for the error estimate."""
    job, channels = task.job, task.job.channels
    direct, (matrix,), arrivals = shadowed(
        job.tracer, job.surfaces, receivers, material, set_of, keep_hits=sent is not None
    )
    diffuse, matrix = direct.T.repeat(1, channels), matrix.repeat(1, 1, channels)
    if sent is None or arrivals is None:
        return diffuse, matrix
    more, further = gathered(arrivals, sent, task.glossy, job.surfaces, receivers, material, set_of)
    return diffuse + more, matrix + further
