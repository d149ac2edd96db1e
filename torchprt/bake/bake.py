"""From a scene to its diffuse transfer: chunks on a thread pool, then bounces, then an estimate of the error."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.bake.bounce import Gather, Surfaces, shadowed_with_hits
from torchprt.bake.checkpoint import Checkpoint, fingerprint
from torchprt.bake.diffuse import Receivers, projection, shadowed, unshadowed
from torchprt.bake.directions import hemisphere
from torchprt.bake.progress import Bar, Report, Silent
from torchprt.errors import InputError
from torchprt.scene import Geometry, Points, Scene
from torchprt.trace import Tracer
from torchprt.transfer import DiffuseTransfer
from torchprt.version import VERSION

# Receivers a chunk: what a crash loses, and what a thread holds. Part of the result's bits, so not a parameter.
CHUNK = 1024
# Light that bounces without end is followed until a bounce adds less than this part of the transfer (RMS).
ENERGY = 1e-4
# The error is measured on this many receivers at most, with this many times the rays.
SAMPLE, SAMPLE_RAYS = 64, 16

R = TypeVar("R")


@dataclass
class _Job:
    """All that a bake is made of, and nothing that changes."""

    tracer: Tracer
    surfaces: Surfaces
    receivers: Receivers
    albedo: Float[Tensor, "V C"]
    order: int
    seed: int

    def directions(self, rays: int) -> tuple[Tensor, Tensor]:
        directions = hemisphere(rays, self.seed)
        return directions, projection(directions, self.order)


def bake(
    scene: Scene,
    *,
    order: int = 5,
    rays: int = 1024,
    bounces: float = 0,
    shadows: bool = True,
    receivers: Points | None = None,
    seed: int = 0,
    threads: int | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: bool | Report = True,
) -> DiffuseTransfer:
    """Diffuse transfer of a scene.

    - `order` of the light that it will answer to, from 1; `rays` a receiver, over its hemisphere. Twice the rays
      take twice the time for about 0.6 of the error.
    - `bounces`: 0 for shadows alone, a count, or `math.inf` to follow light until a bounce adds less than 1e-4 of
      the transfer. `shadows=False` gives the closed form without any ray.
    - `receivers`: points to record at instead of the scene's vertices; bounces still run over the vertices.
    - `checkpoint`: a folder that keeps finished chunks; the same call goes on from there, and removes it when done.
    - `progress`: a bar on standard error, or an object with the methods of `bake.progress.Report`.

    Back faces block; they reflect nothing unless the material is two-sided. Laws: the same bits for any number of
    `threads` and after any interruption; a receiver that nothing blocks has exactly the unshadowed transfer; the
    result does not depend on the scale of the scene or on its distance from the origin.
    The error estimate comes from a spread of receivers traced again with 16 times the rays.
    Memory: the tensors of the scene, Embree's tree, `4 V N C` bytes for the result (three times that with bounces)
    and, a thread, `64 * 2^16` bytes of rays and `1024 (4 N + 8)` of results; with bounces at most `24 * 1024 * rays`
    more for the hits of one chunk. Hits of all others wait on disk: 24 bytes a blocked ray at most.

    Raises InputError if an argument is out of range or the checkpoint folder cannot be used; KeyboardInterrupt after
    finished chunks are kept.
    Source: Sloan, Kautz and Snyder 2002, section 5.
    """
    _check(order, rays, bounces, shadows, seed, threads)
    geometry = scene.geometry()
    if not shadows:
        return _unshadowed(geometry, receivers, order)
    job = _job(geometry, order, seed)
    with contextlib.ExitStack() as stack:
        report: Report = progress if not isinstance(progress, bool) else Silent()
        if progress is True:
            report = stack.enter_context(Bar())
        workers = stack.enter_context(_Workers(threads or os.cpu_count() or 1))
        if receivers is None:
            return _bake_vertices(job, geometry, rays, bounces, scene, checkpoint, workers, report)
        return _bake_points(job, geometry, receivers, rays, bounces, scene, checkpoint, workers, report)


def _check(order: int, rays: int, bounces: float, shadows: bool, seed: int, threads: int | None) -> None:
    if order < 1 or order > 64:
        raise InputError(f"order is {order}: give a number from 1 to 64")
    if rays < 1:
        raise InputError(f"rays is {rays}: give at least 1")
    if not bounces >= 0 or (bounces != math.inf and bounces != int(bounces)):
        raise InputError(f"bounces is {bounces}: give 0, a whole number or infinity")
    if bounces and not shadows:
        raise InputError("bounces need shadows: leave one of the two options out")
    if seed < 0:
        raise InputError(f"seed is {seed}: give a number from 0")
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}: give at least 1")


def _unshadowed(geometry: Geometry, points: Points | None, order: int) -> DiffuseTransfer:
    normals = geometry.receiver_normals if points is None else points.normals
    return _result(geometry, points, unshadowed(normals, order)[None], transport="unshadowed")


def _job(geometry: Geometry, order: int, seed: int) -> _Job:
    tracer = Tracer(geometry.positions, geometry.faces)
    size = _triangle_size(geometry)
    on_receivers = torch.zeros(geometry.receivers, dtype=torch.float64)
    for numbering in (geometry.receiver_of_vertex, geometry.back_receiver_of_vertex):
        on_receivers[numbering[numbering >= 0]] = size[numbering >= 0]
    origins = tracer.origins(geometry.receiver_positions, geometry.receiver_normals, on_receivers)
    surfaces = Surfaces(
        geometry.receiver_of_vertex[geometry.faces], geometry.back_receiver_of_vertex[geometry.faces]
    )
    receivers = Receivers(geometry.receiver_positions, geometry.receiver_normals, origins)
    return _Job(tracer, surfaces, receivers, geometry.albedo, order, seed)


def _triangle_size(geometry: Geometry) -> Float[Tensor, "Vall"]:
    """Longest extent of the triangles around every vertex."""
    corners = geometry.positions[geometry.faces]
    extent = (corners.amax(1) - corners.amin(1)).amax(-1)
    size = torch.zeros(len(geometry.positions), dtype=torch.float64)
    return size.scatter_reduce(0, geometry.faces.flatten(), extent.repeat_interleave(3), "amax")


def _bake_vertices(
    job: _Job,
    geometry: Geometry,
    rays: int,
    bounces: float,
    scene: Scene,
    checkpoint: str | os.PathLike[str] | None,
    workers: _Workers,
    report: Report,
) -> DiffuseTransfer:
    digest = fingerprint(_contents(geometry), _parameters(job, rays, bounces > 0))
    folder = None if checkpoint is None else Path(checkpoint)
    with _checkpoint(folder, digest, needed=folder is not None or bounces > 0) as store:
        transfer, exitant, done = _solve(job, rays, bounces, scene, store, workers, report)
        error, signal = _estimate_error(job, transfer, exitant, rays, workers, report)
        result = _result(
            geometry,
            None,
            transfer,
            transport="interreflected" if done else "shadowed",
            bounces=done,
            rays=rays,
            seed=job.seed,
            error=error,
            signal=signal,
        )
        if store is not None:
            store.discard()
    return result


def _bake_points(
    job: _Job,
    geometry: Geometry,
    points: Points,
    rays: int,
    bounces: float,
    scene: Scene,
    checkpoint: str | os.PathLike[str] | None,
    workers: _Workers,
    report: Report,
) -> DiffuseTransfer:
    """Bounces but the last run over the vertices; the last gathers to the points."""
    exitant, done = None, 0
    channels = scene.requires(bounces).channels
    if bounces:
        digest = fingerprint(_contents(geometry), _parameters(job, rays, True))
        with _checkpoint(None if checkpoint is None else Path(checkpoint), digest, needed=True) as store:
            assert store is not None
            vertices, _, done = _solve(job, rays, bounces - 1, scene, store, workers, report)
            exitant, done = _exitant(vertices, job.albedo), done + 1
            store.discard()
    origins = job.tracer.origins(points.positions, points.normals)
    here = dataclasses.replace(job, receivers=Receivers(points.positions, points.normals, origins))
    transfer = torch.empty(channels, job.order**2, len(points.positions))
    directions, project = here.directions(rays)

    def chunk(rows: slice) -> tuple[slice, Tensor]:
        return rows, _gathered(here, rows, exitant, channels, directions, project)

    report.start("points", len(points.positions) * rays)
    for rows, part in workers.map(chunk, _chunks(len(points.positions))):
        transfer[:, :, rows] = part
        report.advance(part.shape[-1] * rays)
    error, signal = _estimate_error(here, transfer, exitant, rays, workers, report)
    return _result(
        geometry,
        points,
        transfer,
        transport="interreflected" if done else "shadowed",
        bounces=done,
        rays=rays,
        seed=job.seed,
        error=error,
        signal=signal,
    )


def _solve(
    job: _Job,
    rays: int,
    bounces: float,
    scene: Scene,
    store: Checkpoint | None,
    workers: _Workers,
    report: Report,
) -> tuple[Float[Tensor, "C N V"], Float[Tensor, "V W"] | None, int]:
    """Transfer of all receivers; what the last bounce gathered from (None without one); bounces done."""
    channels = scene.requires(bounces).channels
    chunks = _chunks(len(job.receivers))
    transfer = _first_pass(job, rays, store if store is not None else None, workers, report, keep_hits=bounces > 0)
    if not bounces:
        return transfer[None], None, 0
    assert store is not None
    # Vertices first while bouncing: a hit reads one row. Last, the layout that shades.
    total = transfer.T[:, None, :].repeat(1, channels, 1).flatten(1)
    albedo = job.albedo.expand(-1, channels) if channels > 1 else job.albedo[:, :1]
    scaled = albedo.repeat_interleave(job.order**2, dim=1)
    added, gathered_from, done = total, None, 0
    while done < bounces:
        exitant = scaled * added

        def bounce(index: int, exitant: Tensor = exitant) -> tuple[int, Tensor]:
            return index, _load_gather(store, index) @ exitant

        report.start(f"bounce {done + 1}", len(job.receivers))
        added = torch.empty_like(total)
        for index, part in workers.map(bounce, range(len(chunks))):
            added[chunks[index]] = part
            report.advance(len(part))
        energy = float(added.norm() / total.norm().clamp(min=torch.finfo(torch.float32).tiny))
        gathered_from = scaled * total
        total = total + added
        done += 1
        if bounces == math.inf and energy < ENERGY:
            break
    stacked = total.view(len(job.receivers), channels, -1).permute(1, 2, 0).contiguous()
    return stacked, gathered_from, done


def _first_pass(
    job: _Job, rays: int, store: Checkpoint | None, workers: _Workers, report: Report, *, keep_hits: bool
) -> Float[Tensor, "N V"]:
    """Traces every chunk that the checkpoint does not hold yet."""
    chunks = _chunks(len(job.receivers))
    directions, project = job.directions(rays)
    transfer = torch.empty(job.order**2, len(job.receivers))
    missing = []
    for index, rows in enumerate(chunks):
        kept = None if store is None else store.load(index)
        if kept is None:
            missing.append(index)
        else:
            transfer[:, rows] = kept["transfer"]

    def trace(index: int) -> tuple[int, Tensor]:
        receivers = job.receivers[chunks[index]]
        if keep_hits:
            part, gather = shadowed_with_hits(job.tracer, job.surfaces, receivers, directions, project)
            contents = {"transfer": part, **vars(gather)}
        else:
            part = shadowed(job.tracer, receivers, directions, project)
            contents = {"transfer": part}
        if store is not None:
            store.save(index, contents)
        return index, part

    size = rays * len(job.receivers)
    report.start("trace", size, size - rays * sum(chunks[index].stop - chunks[index].start for index in missing))
    for index, part in workers.map(trace, missing):
        transfer[:, chunks[index]] = part
        report.advance(part.shape[1] * rays)
    return transfer


def _load_gather(store: Checkpoint, index: int) -> Gather:
    contents = store.load(index)
    if contents is None:
        raise InputError(f"{store.path(index)} vanished or was damaged during the bake: run it again")
    return Gather(contents["offsets"], contents["sources"], contents["weights"])


def _gathered(
    job: _Job, rows: slice | Tensor, exitant: Tensor | None, channels: int, directions: Tensor, project: Tensor
) -> Float[Tensor, "C N v"]:
    """Shadowed transfer of some receivers plus one gather of what the surfaces around them reflect."""
    receivers = job.receivers[rows]
    if exitant is None:
        return shadowed(job.tracer, receivers, directions, project).expand(channels, -1, -1)
    direct, gather = shadowed_with_hits(job.tracer, job.surfaces, receivers, directions, project)
    bounced = (gather @ exitant).view(len(receivers), channels, -1).permute(1, 2, 0)
    return direct + bounced


def _exitant(transfer: Float[Tensor, "C N V"], albedo: Float[Tensor, "V D"]) -> Float[Tensor, "V W"]:
    """Transfer times albedo, vertices first, channels and coefficients in one row."""
    channels = len(transfer)
    factors = albedo.expand(-1, channels) if channels > 1 else albedo[:, :1]
    return (transfer.permute(2, 0, 1) * factors[:, :, None]).flatten(1)


def _estimate_error(
    job: _Job, transfer: Float[Tensor, "C N V"], exitant: Tensor | None, rays: int, workers: _Workers, report: Report
) -> tuple[float | None, float | None]:
    """RMS error of a coefficient on a spread of receivers, and RMS of a coefficient over all."""
    alive = torch.nonzero(job.receivers.normals.abs().sum(-1) > 0)[:, 0]
    if len(alive) == 0:
        return None, None
    count = min(len(alive), max(8, min(SAMPLE, len(alive) // 512)))
    generator = torch.Generator().manual_seed(job.seed)
    chosen = alive[torch.randperm(len(alive), generator=generator)[:count]]
    # Another seed, so that the reference is not a refinement of the same set.
    directions, project = dataclasses.replace(job, seed=job.seed + 1).directions(SAMPLE_RAYS * rays)

    def difference(rows: Tensor) -> float:
        better = _gathered(job, rows, exitant, len(transfer), directions, project)
        report.advance(len(rows) * len(directions))
        return float((transfer[:, :, rows] - better).double().square().mean())

    report.start("error", count * len(directions))
    squares = list(workers.map(difference, list(chosen.split(1))))
    signal = math.sqrt(float(transfer[:, :, alive].double().square().mean()))
    return math.sqrt(sum(squares) / count), signal


def _result(geometry: Geometry, points: Points | None, transfer: Tensor, **metadata) -> DiffuseTransfer:
    if points is None:
        positions, normals, albedo = geometry.receiver_positions, geometry.receiver_normals, geometry.albedo
        faces = geometry.display_faces
    else:
        positions, normals, albedo = points.positions, points.normals, torch.as_tensor(points.albedo)
        faces = torch.zeros(0, 3)
    uniform = len(albedo) > 0 and bool((albedo == albedo[0]).all())
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


def _contents(geometry: Geometry) -> list[Tensor]:
    """The tensors that decide what is traced. Albedo is not among them: it enters after tracing."""
    numberings = [geometry.receiver_of_vertex, geometry.back_receiver_of_vertex]
    return [geometry.positions, geometry.faces, geometry.receiver_positions, geometry.receiver_normals, *numberings]


def _parameters(job: _Job, rays: int, hits: bool) -> dict[str, object]:
    return {"order": job.order, "rays": rays, "seed": job.seed, "hits": hits, "chunk": CHUNK, "version": VERSION}


@contextlib.contextmanager
def _checkpoint(folder: Path | None, digest: str, *, needed: bool) -> Iterator[Checkpoint | None]:
    if not needed:
        yield None
        return
    store = Checkpoint(folder, digest)
    try:
        yield store
    finally:
        store.close()


def _chunks(count: int) -> list[slice]:
    return [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]


class _Workers:
    """A pool of threads, each with torch on one thread: the bits of a product depend on how it is split."""

    def __init__(self, threads: int):
        self.threads = threads

    def __enter__(self) -> _Workers:
        self._torch_threads = torch.get_num_threads()
        torch.set_num_threads(1)
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="bake")
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        torch.set_num_threads(self._torch_threads)

    def map(self, function: Callable[..., R], items: Sequence) -> Iterator[R]:
        """Results as they come. When the consumer stops (Ctrl-C), what runs is finished and the rest is dropped."""
        pending: set[Future[R]] = set()
        waiting = iter(items)
        try:
            while True:
                # Few in flight: their results must not pile up behind a slow consumer.
                while len(pending) < 2 * self.threads and (item := next(waiting, None)) is not None:
                    pending.add(self._pool.submit(function, item))
                if not pending:
                    return
                finished, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield future.result()
        finally:
            for future in pending:
                future.cancel()
            wait(pending)
