"""From a scene to its diffuse transfer."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchprt.bake.checkpoint import Checkpoint, fingerprint
from torchprt.bake.diffuse import unshadowed
from torchprt.bake.estimate import error_and_signal
from torchprt.bake.progress import Bar, Report, Silent
from torchprt.bake.receivers import Receivers
from torchprt.bake.solve import (
    Job,
    Solution,
    exit_radiance,
    gathered,
    solve,
    surfaces,
    trace,
    vertex_receivers,
)
from torchprt.bake.workers import CHUNK, Workers, chunks
from torchprt.errors import InputError
from torchprt.scene import Geometry, Points, Scene
from torchprt.trace import Tracer
from torchprt.transfer import DiffuseTransfer
from torchprt.version import VERSION


def bake(
    scene: Scene,
    *,
    order: int = 5,
    rays: int = 1024,
    bounces: int | float = 0,
    shadows: bool = True,
    receivers: Points | None = None,
    seed: int = 0,
    threads: int | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    keep: bool = False,
    progress: bool | Report = True,
) -> DiffuseTransfer:
    """Diffuse transfer of a scene.

    - `order` of the light that it will answer to, from 1; `rays` a receiver, over its hemisphere. Four times the
      rays take four times the time for a third of the error.
    - `bounces`: 0 for shadows alone, a count, or `math.inf` to follow light until a bounce adds less than 1e-4 of
      the transfer. `shadows=False` gives the closed form without any ray.
    - `receivers`: points to record at instead of the scene's vertices; bounces still run over the vertices.
    - `checkpoint`: a folder that keeps finished chunks; the same call goes on from there, and removes it when done
      unless it is to `keep` it (until the result is safe on disk, say).
    - `progress`: a bar on standard error, or an object with the methods of `bake.progress.Report`.

    Back faces block; they reflect nothing unless the material is two-sided. Laws: the same bits for any number of
    `threads` and after any interruption; a receiver that nothing blocks has exactly the unshadowed transfer; the
    result does not depend on the scale of the scene or on its distance from the origin.
    The error estimate comes from a spread of receivers traced again with 8 times the rays.
    Memory: the tensors of the scene, Embree's tree, `4 V N C` bytes for the result (four times that with bounces),
    some 550 V of copies that live for a moment and `224 N rays` of the basis along the directions of the estimate;
    and, a thread, `72 max(2^16, 8 rays)` of rays and `512 (8 N + 36)` of results, with bounces at most
    `24 * 512 * rays` more for the hits of a chunk. The hits of all others wait on disk (in the checkpoint, or in the
    system's temporary folder): at most 24 bytes a blocked ray.

    Raises InputError if an argument is out of range or the checkpoint folder cannot be used; KeyboardInterrupt after
    the chunks that are being traced are finished and kept.
    Source: Sloan, Kautz and Snyder 2002, section 5.
    """
    _check(order, rays, bounces, shadows, seed, threads)
    geometry = scene.geometry()
    if not shadows:
        normals = geometry.receiver_normals if receivers is None else receivers.normals
        return _result(geometry, receivers, unshadowed(normals, order)[None], transport="unshadowed")
    tracer = Tracer(geometry.positions, geometry.faces)
    channels = scene.requires(bounces).channels
    job = Job(tracer, surfaces(geometry), vertex_receivers(geometry, tracer), order, rays, seed, channels)
    folder = None if checkpoint is None else Path(checkpoint)
    with contextlib.ExitStack() as stack:
        report: Report = progress if not isinstance(progress, bool) else Silent()
        if progress is True:
            report = stack.enter_context(Bar())
        workers = stack.enter_context(Workers(threads or os.cpu_count() or 1))
        store = stack.enter_context(_store(folder, job, geometry, receivers, bounces))
        if receivers is None:
            solution = solve(job, geometry.albedo, bounces, store, workers, report)
        else:
            job, solution = _at_points(job, receivers, geometry.albedo, bounces, store, workers, report)
        error, signal = error_and_signal(job, solution.transfer, solution.exitant, workers, report)
        result = _result(
            geometry,
            receivers,
            solution.transfer,
            transport="interreflected" if solution.bounces else "shadowed",
            bounces=solution.bounces,
            rays=rays,
            seed=seed,
            error=error,
            signal=signal,
        )
        if store is not None and not keep:
            store.discard()
    return result


def _check(order: int, rays: int, bounces: int | float, shadows: bool, seed: int, threads: int | None) -> None:
    if not 1 <= order <= 64:
        raise InputError(f"order is {order}: give a number from 1 to 64")
    if not 1 <= rays <= 1 << 22:
        raise InputError(f"rays is {rays}: give a number from 1 to {1 << 22}")
    if not bounces >= 0 or (bounces != math.inf and bounces != int(bounces)):
        raise InputError(f"bounces is {bounces}: give 0, a whole number or infinity")
    if bounces and not shadows:
        raise InputError("bounces need shadows: leave one of the two options out")
    if seed < 0:
        raise InputError(f"seed is {seed}: give a number from 0")
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}: give at least 1")


def _at_points(
    job: Job,
    points: Points,
    albedo: Tensor,
    bounces: int | float,
    store: Checkpoint | None,
    workers: Workers,
    report: Report,
) -> tuple[Job, Solution]:
    """Transfer at points: all bounces but the last run over the vertices, the last gathers to the points."""
    origins = job.tracer.origins(points.positions, points.normals)
    here = dataclasses.replace(job, receivers=Receivers(points.positions, points.normals, origins))
    if not bounces:
        return here, Solution(trace(here, store, workers, report, keep_hits=False)[None])
    assert store is not None
    over_vertices = solve(job, albedo, bounces - 1, store, workers, report)
    exitant = exit_radiance(over_vertices.transfer.expand(job.channels, -1, -1), albedo)
    directions, project = here.directions()
    everything = chunks(len(here.receivers))
    # The store numbers the chunks of the points after those of the vertices.
    first = len(chunks(len(job.receivers)))

    def one(index: int) -> tuple[int, Tensor]:
        kept = store.load(first + index)
        if kept is None:
            kept = {"transfer": gathered(here, everything[index], exitant, directions, project)}
            store.save(first + index, kept)
        return index, kept["transfer"]

    transfer = torch.empty(job.channels, job.order**2, len(here.receivers))
    report.start("points", len(here.receivers) * job.rays)
    for index, part in workers.map(one, range(len(everything))):
        transfer[:, :, everything[index]] = part
        report.advance(part.shape[-1] * job.rays)
    return here, Solution(transfer, exitant, over_vertices.bounces + 1)


@contextlib.contextmanager
def _store(
    folder: Path | None, job: Job, geometry: Geometry, points: Points | None, bounces: int | float
) -> Iterator[Checkpoint | None]:
    """Where chunks are kept: the named folder, a temporary one if hits must wait for bounces, or none."""
    if folder is None and not bounces:
        yield None
        return
    contents = [geometry.positions, geometry.faces, geometry.receiver_positions, geometry.receiver_normals]
    contents += [geometry.receiver_of_vertex, geometry.back_receiver_of_vertex]
    parameters: dict[str, Any] = {
        "order": job.order,
        "rays": job.rays,
        "seed": job.seed,
        "hits": bounces > 0,
        "chunk": CHUNK,
        "version": VERSION,
    }
    if points is not None:
        # What the points gather has bounced already; elsewhere bounces and albedo enter after tracing.
        contents += [points.positions, points.normals, geometry.albedo]
        parameters["bounces"] = bounces
    store = Checkpoint(folder, fingerprint(contents, parameters))
    try:
        yield store
    finally:
        store.close()


def _result(geometry: Geometry, points: Points | None, transfer: Tensor, **metadata: Any) -> DiffuseTransfer:
    if points is None:
        positions, normals, albedo = geometry.receiver_positions, geometry.receiver_normals, geometry.albedo
        faces = geometry.display_faces
    else:
        positions, normals, albedo = points.positions, points.normals, torch.as_tensor(points.albedo)
        faces = torch.zeros(0, 3)
    uniform = len(albedo) > 0 and bool((albedo == albedo[0]).all())
    # A scan comes in float32: twice the bytes would say nothing more.
    single = positions.to(torch.float32)
    exact = bool((single.to(torch.float64) == positions).all())
    return DiffuseTransfer(
        transfer=transfer,
        albedo=albedo[:1].clone() if uniform else albedo,
        positions=single if exact else positions,
        normals=normals.to(torch.float32),
        faces=faces.to(torch.int32),
        version=VERSION,
        **metadata,
    )
