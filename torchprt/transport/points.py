"""Transfer at points that are no vertices: all bounces but the last run over the surfaces, the last gathers to them."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from torchprt.scene import Geometry, Glosses, Points
from torchprt.transfer import Transfer
from torchprt.transport import solve, solve_glossy
from torchprt.transport.bake_glossy import Wanted, finished, job_of, recording_of, warn_of_order
from torchprt.transport.diffuse_tasks import Job, Record
from torchprt.transport.directions import frames
from torchprt.transport.glossy import Exitant, Glossy, glossy
from torchprt.transport.glossy_tasks import GlossyRecord
from torchprt.transport.receivers import Receivers
from torchprt.transport.solve import Solution, exit_radiance, trace
from torchprt.transport.solve_glossy import Arrived, GlossySolution, exitant
from torchprt.transport.stages import Stages
from torchprt.transport.tables import in_channels
from torchprt.transport.task import chunks


def among(points: Points, scene: Geometry) -> Geometry:
    """A scene whose receivers are points: its surfaces block and reflect nothing, its mirrors are not drawn."""
    of_point = points.gloss.of_vertex if isinstance(points.gloss, Glosses) else torch.full((len(points.positions),), -1)
    models = points.gloss.models if isinstance(points.gloss, Glosses) else ()
    shiny = torch.nonzero(of_point >= 0)[:, 0]
    used, which = of_point[shiny].unique(return_inverse=True)
    given, count = torch.as_tensor(points.tangents)[shiny], len(points.positions)
    tangents = torch.where((given == 0).all(-1, keepdim=True), frames(points.normals[shiny])[:, 0], given)
    none = torch.full_like(scene.receiver_of_vertex, -1)
    return dataclasses.replace(
        scene,
        two_sided=torch.zeros_like(scene.two_sided),
        receiver_of_vertex=none,
        back_receiver_of_vertex=none,
        receiver_positions=points.positions,
        receiver_normals=points.normals,
        albedo=torch.as_tensor(points.albedo),
        display_faces=torch.zeros(0, 3, dtype=torch.int64),
        slices=(),
        back_slices=(),
        glossy=shiny,
        gloss=tuple(models[number] for number in used.tolist()),
        gloss_of_glossy=which,
        tangents=tangents,
        specular=torch.as_tensor(points.specular)[shiny],
        partner=torch.full((count,), -1),
        translucency=torch.zeros(count),
        mirror=torch.full_like(scene.mirror, -1),
        reflectance=torch.zeros(0, 1),
        names=(),
        roles=(),
        media=(),
        tangent_fields=(),
    )


def at_points(
    job: Job, scene: Geometry, points: Geometry, bounces: int | float, stages: Stages
) -> tuple[Job, Solution]:
    """Diffuse transfer at points among diffuse surfaces, and the job of recording there."""
    here = _here(job, points)
    if not bounces:
        transfer, cut = trace(here, stages, keep_hits=False)
        return here, Solution(transfer, transfer, cut=cut)
    over_vertices, sent = _sent(job, scene, bounces, stages)
    tasks = [Record(rows, job.rays, job.seed) for rows in chunks(len(here.receivers))]
    transfer = stages.tables.empty(len(here.receivers), job.channels * job.order**2)
    for task, found in stages.run("points", tasks, here, sent, first=_first(job)):
        transfer[task.index] = found["transfer"].permute(2, 0, 1).flatten(1)
    return here, Solution(transfer, transfer, sent, over_vertices.bounces + 1, over_vertices.cut)


def bake_points(
    job: Job, scene: Geometry, points: Geometry, wanted: Wanted, bounces: int | float, stages: Stages
) -> Transfer:
    """Transfer at points, where they or the surfaces around them are glossy."""
    worst = warn_of_order(wanted, points, job.order)
    # Surfaces that are hit are shaded from exit functions, whatever the points record.
    of_hits = dataclasses.replace(wanted, frame="exit", projection="optimal", factors=None)
    recording = recording_of(wanted if len(points.glossy) else of_hits, points, job.order)
    task = job_of(_here(job, points), points, recording)
    if not bounces:
        return finished(task, points, wanted, solve_glossy.solve(task, 0, stages), worst, stages)
    warn_of_order(of_hits, scene, job.order)
    if len(scene.glossy):
        hit, sent, bounces, cut = sent_by_glossy(job, scene, of_hits, bounces, stages)
    else:
        over_vertices, vectors = _sent(job, scene, bounces, stages)
        hit, sent = _none_glossy(job), Exitant(vectors, 1)
        bounces, cut = over_vertices.bounces + 1, over_vertices.cut
    task = dataclasses.replace(task, hit=hit)
    columns = job.channels * task.recording.columns
    arrived = Arrived(
        stages.tables.empty(len(task.job.receivers), job.channels * job.order**2),
        stages.tables.empty(len(points.glossy), task.recording.count, columns),
    )
    tasks = [GlossyRecord(rows, job.rays, job.seed) for rows in chunks(len(task.job.receivers))]
    for chunk, found in stages.run("points", tasks, task, sent, first=_first(job)):
        arrived.diffuse[chunk.index] = found["transfer"]
        if "matrix" in found:
            arrived.matrix[task.glossy.among(chunk.index)] = found["matrix"]
    return finished(task, points, wanted, GlossySolution(arrived, sent, int(bounces), cut), worst, stages)


def _here(job: Job, points: Geometry) -> Job:
    """The job with points for its receivers. Nothing comes through membranes or bodies to them."""
    where, normals = points.receiver_positions, points.receiver_normals
    receivers = Receivers(where, normals, job.tracer.origins(where, normals))
    return dataclasses.replace(job, receivers=receivers, validity=None, sheets=None, bodies=())


def _first(job: Job) -> int:
    """The store numbers the chunks of the points after those of the vertices."""
    return len(chunks(len(job.receivers)))


def _sent(job: Job, scene: Geometry, bounces: int | float, stages: Stages) -> tuple[Solution, Tensor]:
    """Transfer of diffuse surfaces with all bounces but the last, and what they send out of it."""
    found = solve.solve(job, scene.albedo, bounces - 1, stages)
    columns = job.order**2
    leaving = in_channels(found.shown, job.channels * columns // found.shown.shape[1], stages.tables)
    return found, exit_radiance(leaving, scene.albedo, columns, stages.tables)


def sent_by_glossy(
    job: Job, scene: Geometry, wanted: Wanted, bounces: int | float, stages: Stages
) -> tuple[Glossy, Exitant, int, float | None]:
    """What surfaces send out, some of them glossy, with all bounces but the last: which are glossy, the bounces with
    the last one, and what was cut off among mirrors."""
    task = job_of(job, scene, recording_of(wanted, scene, job.order))
    found = solve_glossy.solve(task, bounces - 1, stages)
    columns = found.arrived.diffuse.shape[1]
    arrived = solve_glossy.repeated(found.arrived, job.channels * job.order**2 // columns, stages.tables)
    return task.glossy, exitant(task, arrived, stages), found.bounces + 1, found.cut


def _none_glossy(job: Job) -> Glossy:
    nothing = torch.zeros(0, dtype=torch.int64)
    return glossy(job.receivers, nothing, torch.zeros(0, 3, dtype=torch.float64), nothing, ())
