"""From a scene to its transfer."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torch import Tensor

from torchprt.checkpoint import fingerprint
from torchprt.errors import InputError
from torchprt.files import CannotWrite, no_temporary
from torchprt.progress import Report, Silent
from torchprt.scene import Geometry, Lightmap, Points, Scene, Volume
from torchprt.sh import Projection
from torchprt.trace import Tracer
from torchprt.transfer import Transfer
from torchprt.transfer.pieces import rows
from torchprt.transport import bake_glossy, result
from torchprt.transport.bake_glossy import Frame, Wanted
from torchprt.transport.bounce import Surfaces
from torchprt.transport.bounces import Bounces, check_bounces, followed
from torchprt.transport.checkpoint import Checkpoint, kept_at, place_of
from torchprt.transport.cluster import Cluster, on_clusters
from torchprt.transport.diffuse import unshadowed
from torchprt.transport.diffuse_tasks import Job
from torchprt.transport.directions import hemisphere
from torchprt.transport.estimate import error_and_signal
from torchprt.transport.membrane import sheets
from torchprt.transport.mirrors import warn_of_cut
from torchprt.transport.output import Output, output_of
from torchprt.transport.points import among, at_points, bake_points
from torchprt.transport.progress import Bar
from torchprt.transport.sight import with_sight
from torchprt.transport.solve import solve, surfaces, vertex_receivers
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface import bodies_of, unshadowed_through
from torchprt.transport.tables import InMemory, Mapped, Tables, channels_first
from torchprt.transport.task import CHUNK, Runner
from torchprt.transport.texels import Lightmapped, lightmapped
from torchprt.transport.texels import with_sight as texels_with_sight
from torchprt.transport.through_volume import ThroughVolume, through
from torchprt.transport.workers import Threads, torch_on_one_thread
from torchprt.version import VERSION

if TYPE_CHECKING:
    from distributed import Client

    from torchprt.transport.object_store import ObjectCheckpoint


@on_clusters
@torch_on_one_thread()
def bake(
    scene: Scene,
    *,
    order: int = 5,
    rays: int = 1024,
    bounces: Bounces = 0,
    shadows: bool = True,
    receivers: Points | None = None,
    lightmap: Lightmap | None = None,
    volume: Volume | Transfer | None = None,
    seed: int = 0,
    threads: int | None = None,
    runner: Runner | None = None,
    on: Client | Cluster | str | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    keep: bool = False,
    out: str | os.PathLike[str] | Output | None = None,
    progress: bool | Report = True,
    frame: Frame = "exit",
    output_order: int | None = None,
    projection: Projection = "optimal",
    factors: int | float | None = None,
    visibility_order: int | None = None,
    raw: bool = False,
) -> Transfer:
    """Transfer of a scene: a layer of what is diffuse in it, and one of what is glossy.

    - `order` of the light that it will answer to, from 1; `rays` a receiver, over its hemisphere. Four times the
      rays take four times the time for a third of the error.
    - `bounces`: 0 for shadows alone, a count, `math.inf` to follow light until a bounce adds less than 1e-4 of the
      transfer (RMS), or "auto" until one adds less than 1e-2, which is none at all where nothing reflects, without
      shadows and in the frame "visibility". `bounces` of the result is how many it took. `shadows=False` gives the
      closed form without any ray.
    - `receivers`: points to record at instead of the scene's vertices, of an albedo and a gloss of their own; all
      bounces but the last still run over the vertices.
    - `lightmap`: record at the texels of a map of the scene's surfaces instead, and follow bounces from texel to texel:
      `Atlas` receivers, however coarse the meshes are. A texel records with one frame, about the mean normal of its
      samples, and its rays start from each sample in turn.
    - `volume`: what light goes through on its way to the surfaces and between them. A `Volume` casts shadow alone; the
      transfer of `bake_volume` also sends them the light that it scatters. What surfaces send is not scattered by it.
    - `threads`: as many as the machine has cores by default; or instead a `runner` of tasks, such as `Processes`.
    - `on`: a Dask cluster that does the work, `transport.Cluster`: a client of it, the address of its scheduler, or
      "local:4" for four processes of this machine.
    - `checkpoint`: a folder that keeps finished chunks, or the URL of one that fsspec opens (`s3://...`), which a
      cluster of several machines needs if anything bounces; the same call goes on from there, and removes it when done
      unless it is to `keep` it (until the result is safe on disk, say).
    - `out`: a `.safetensors` to write, part by part, for a result that is larger than memory. What grows with receivers
      times coefficients then stands in files beside it that are mapped into memory, the same bits as without; the
      tensors of the result are maps of the file (an `Output` says more, as a dtype). Chunks are kept in a folder
      OUT.partial unless a `checkpoint` is named.
    - `progress`: a bar on standard error, or an object with the methods of `torchprt.progress.Report`.

    - `raw`: leave receivers that cannot see as they are, black; otherwise see `with_sight`: they are turned, moved, or
      filled from their neighbours along the surface, and `Vertices.sight` of the result says which.

    For glossy materials:
    - `frame`: "exit" (the BRDF baked in: layer `Exit`), "incident" (the BRDF chosen at run time:
      `Incident`) or "visibility" (a vector instead of a matrix, multiplied with the light at run time:
      `Visibility`; one material, no bounces).
    - `output_order` (that of the light by default): bands of exit radiance, or of incident radiance. More of them hold
      narrower lobes; `OrderWarning` tells when the material needs more, `exit_error` of the result how well they do.
    - `projection` of exit radiance on the hemisphere, see `sh.exit_functions`.
    - `factors`: a number of view factors in place of exit functions, or (a float) the error that they may leave:
      `Factored`; one material.
    - `visibility_order` (that of the light by default): bands of visibility in the frame "visibility".
    Diffuse and glossy surfaces light each other, from the same rays.

    Light diffuses in the body of a material with `subsurface` and leaves it elsewhere, in three channels (see
    `Material`); `error` and `signal` of the result are then of what arrives. Points get none of it but what surfaces
    reflect to them.

    Light that meets a mirror goes on from both of its sides, up to `trace.REFLECTIONS` times from mirror to mirror;
    what is cut off then is `cut` of the result, a share of what could arrive, and a `MirrorWarning` above 0.1 %.

    Back faces block; they reflect nothing unless the material is two-sided. Laws: the same bits for any number of
    `threads`, any `runner` and after any interruption; a receiver that nothing blocks has exactly the unshadowed
    transfer; the result does not depend on the scale of the scene or on its distance from the origin.
    The error estimate comes from a spread of receivers traced again with 8 times the rays.
    Memory: the tensors of the scene, Embree's tree, `4 V N C` bytes for the result (four times that with bounces),
    some 550 V of copies that live for a moment and `224 N rays` of the basis along the directions of the estimate;
    and, a thread, `72 max(2^16, 8 rays)` of rays and `512 (8 N + 36)` of results, with bounces at most
    `24 * 512 * rays` more for the hits of a chunk. The hits of all others wait on disk (in the checkpoint, or in the
    system's temporary folder): at most 24 bytes a blocked ray.
    Matrices add `4 G M N C` bytes (twice that while the result is put together, six times with bounces) and
    `36 M N rays` for the products along the directions of the estimate; a thread `4 * 512 M N` of results, with
    bounces `4 N C max(2^16, rays)` of what arrives.

    With `out` what grows with the receivers is the scene, its tree and the copies alone; on disk there are
    `4 V N C` bytes for the file, as many for what arrives, twice as many more while something bounces (three times with
    membranes), and the checkpoint. Matrices alike.

    Raises InputError if an argument is out of range, does not fit the scene, or the checkpoint folder cannot be used,
    and with `out` if light diffuses in bodies;
    KeyboardInterrupt after the chunks that are being traced are finished and kept.
    Source: Sloan, Kautz and Snyder 2002, section 5; Sloan, Hall, Hart and Snyder 2003, section 3.
    """
    check_numbers(order, rays, bounces, shadows, seed, threads, runner)
    output = output_of(out)
    tables: Tables = InMemory() if output is None else Mapped(Path(output.path))
    geometry = scene.geometry()
    texels: Lightmapped | None = None
    if lightmap is not None:
        if receivers is not None:
            raise InputError("receivers and a lightmap are both given: leave one of the two out")
        if shadows and lightmap.samples > rays:
            raise InputError(
                f"{rays} rays a texel cannot start from {lightmap.samples} samples: give more, or fewer samples"
            )
        held = 0 if output is not None else numbers(scene, order, bounces, output_order)
        texels = lightmapped(scene, geometry, lightmap, held)
        geometry = texels.geometry
    membranes, bodies = sheets(geometry), bodies_of(geometry)
    if output is not None and bodies and receivers is None:
        raise InputError(
            "light that diffuses in a body comes from all of it, which must be in memory: bake without an output that "
            "is written in parts, or leave the subsurface out"
        )
    wanted = Wanted(frame, output_order or order, projection, factors, visibility_order or order)
    recorded = geometry if receivers is None else among(receivers, geometry)
    is_glossy = scene.requires().kind == "glossy" or len(recorded.glossy) > 0
    bounces, enough = followed(bounces, geometry, can=shadows and not (is_glossy and frame == "visibility"))
    if is_glossy:
        bake_glossy.check(wanted, recorded, bounces)
    elif wanted != Wanted("exit", order, "optimal", None, order):
        raise InputError("frame, output_order, projection and factors are for glossy materials: the scene has none")
    between = _between(volume, geometry, order, shadows, wanted if is_glossy else None)
    baked: Transfer
    if not shadows:
        shown = tables.empty(recorded.receivers, order**2)
        for some in rows(*shown.shape):
            shown[some] = unshadowed(recorded.receiver_normals[some], order).T
        if receivers is None:
            shown = shown if membranes is None else membranes.through(shown, tables)
            with Threads(threads or os.cpu_count() or 1) as workers:
                shown = unshadowed_through(shown, bodies, Stages(workers, Silent()))
        if is_glossy and (receivers is None or len(recorded.glossy)):
            baked = bake_glossy.bake_unshadowed(recorded, wanted, order, shown, tables)
        else:
            vectors = channels_first(shown, order**2, tables)
            baked = result.diffuse(recorded, vectors, transport="unshadowed")
        baked = baked if texels is None else dataclasses.replace(baked, receivers=texels.atlas(None))
        return baked if output is None else output.written(baked)
    tracer = Tracer(geometry.positions, geometry.faces)
    channels = max(scene.requires(bounces).channels, 1 if between is None else between.channels)
    if texels is not None:
        met: Surfaces = texels.surfaces(between)
        everything, validity = texels.receivers(tracer), None
        if not raw:
            everything, validity = texels_with_sight(texels, tracer, everything)
    else:
        everything, validity = vertex_receivers(geometry, tracer), None
        if not raw:
            with Threads(threads or os.cpu_count() or 1) as workers:
                geometry, everything, validity = with_sight(geometry, tracer, everything, workers)
        met = surfaces(geometry, between)
    job = Job(tracer, met, everything, order, rays, seed, channels, membranes, validity, enough, bodies)
    folder = place_of(checkpoint)
    if folder is None and output is not None:
        folder = output.partial
    with contextlib.ExitStack() as stack:
        report: Report = progress if not isinstance(progress, bool) else Silent()
        if progress is True:
            report = stack.enter_context(Bar(engine=tracer.engine))
        points = None if receivers is None else recorded
        store = stack.enter_context(store_of(folder, job, geometry, points, bounces, wanted if is_glossy else None))
        if runner is None:
            runner = stack.enter_context(Threads(threads or os.cpu_count() or 1))
        stages = Stages(runner, report, store, tables)
        if points is not None and (len(points.glossy) or (bounces and len(geometry.glossy))):
            baked = bake_points(job, geometry, points, wanted, bounces, stages)
        elif is_glossy and points is None:
            baked = bake_glossy.bake_vertices(job, geometry, wanted, bounces, stages)
        else:
            baked = _diffuse(job, geometry, points, bounces, stages)
        if texels is not None:
            baked = dataclasses.replace(baked, receivers=texels.atlas(validity))
        if output is not None:
            baked = output.written(baked)
        if store is not None and not keep:
            store.discard()
    warn_of_cut(baked.cut)
    return baked


def numbers(scene: Scene, order: int, bounces: Bounces, output_order: int | None) -> int:
    """float32 numbers that a bake holds of each receiver: of vectors, and of matrices of glossy ones."""
    needed = scene.requires(0 if bounces == 0 else math.inf)
    count = needed.channels * order**2 * (1 if bounces == 0 else 4)
    return count * (1 + (output_order or order) ** 2) if needed.kind == "glossy" else count


def bytes_held(
    scene: Scene, *, order: int, bounces: Bounces, output_order: int | None = None, lightmap: Lightmap | None = None
) -> int:
    """Bytes that a bake without `out` holds of what grows with receivers times coefficients, at most."""
    sides = [len(each.two_sided) + int(each.two_sided.sum()) for each in scene.objects if each.receives]
    receivers = sum(sides) if lightmap is None else lightmap.rows * lightmap.columns
    return 4 * receivers * numbers(scene, order, bounces, output_order)


def _diffuse(job: Job, geometry: Geometry, points: Geometry | None, bounces: int | float, stages: Stages) -> Transfer:
    if points is None:
        solution = solve(job, geometry.albedo, bounces, stages)
    else:
        job, solution = at_points(job, geometry, points, bounces, stages)
    error, signal = error_and_signal(job, solution.arriving, solution.exitant, stages)
    # Makes room before the signal is laid out.
    solution.exitant = None
    return result.diffuse(
        geometry if points is None else points,
        channels_first(solution.shown, job.order**2, stages.tables),
        job.validity,
        transport="interreflected" if solution.bounces else "shadowed",
        bounces=solution.bounces,
        rays=job.rays,
        seed=job.seed,
        error=error,
        signal=signal,
        cut=solution.cut,
    )


def _between(
    volume: Volume | Transfer | None, geometry: Geometry, order: int, shadows: bool, wanted: Wanted | None
) -> ThroughVolume | None:
    """What light goes through, if it does. InputError if it cannot be recorded with the rest."""
    between = through(volume, order)
    if between is None:
        return None
    if not shadows:
        raise InputError("a volume casts shadows: leave it out, or bake with shadows")
    if len(geometry.reflectance):
        raise InputError("light that mirrors turn is not followed through a volume: leave one of the two out")
    if between.emission is not None and wanted is not None and wanted.frame == "visibility":
        raise InputError(
            "frame 'visibility' cannot hold the light of a volume: give the Volume itself, or bake matrices"
        )
    return between


def check_numbers(
    order: int,
    rays: int,
    bounces: Bounces,
    shadows: bool,
    seed: int,
    threads: int | None,
    runner: Runner | None,
) -> None:
    if not 1 <= order <= 64:
        raise InputError(f"order is {order}: give a number from 1 to 64")
    if not 1 <= rays <= 1 << 22:
        raise InputError(f"rays is {rays}: give a number from 1 to {1 << 22}")
    check_bounces(bounces)
    if bounces not in (0, "auto") and not shadows:
        raise InputError("bounces need shadows: leave one of the two options out")
    if seed < 0:
        raise InputError(f"seed is {seed}: give a number from 0")
    if threads is not None and threads < 1:
        raise InputError(f"threads is {threads}: give at least 1")
    if threads is not None and runner is not None:
        raise InputError("threads and a runner are both given: leave one of the two out")


@contextlib.contextmanager
def store_of(
    folder: Path | str | None,
    job: Job,
    geometry: Geometry,
    points: Geometry | None,
    bounces: int | float,
    wanted: Wanted | None,
    **more: Any,
) -> Iterator[Checkpoint | ObjectCheckpoint | None]:
    """Where chunks are kept: the named place (`place_of`), a temporary folder if hits must wait for bounces, or none.
    `more`: what else the results depend on."""
    if folder is None and not bounces:
        yield None
        return
    contents = [geometry.positions, geometry.faces, geometry.receiver_positions, geometry.receiver_normals]
    contents += [geometry.receiver_of_vertex, geometry.back_receiver_of_vertex, job.receivers.origins]
    contents += job.surfaces.contents()
    if len(geometry.reflectance):
        contents += [geometry.mirror, geometry.reflectance, geometry.mirror_normals]
    parameters: dict[str, Any] = {
        "order": job.order,
        "rays": job.rays,
        "seed": job.seed,
        # A few rays end elsewhere with another engine.
        "engine": job.tracer.engine,
        "hits": bounces > 0,
        "chunk": CHUNK,
        "version": VERSION,
        **more,
    }
    if job.surfaces.volume is not None:
        contents += job.surfaces.volume.contents()
    if wanted is not None:
        parameters["glossy"] = repr(wanted)
        # The values, not the text: tables have no text of their own.
        probes = hemisphere(64)
        for each in (geometry,) if points is None else (geometry, points):
            contents += [each.glossy, each.gloss_of_glossy, each.tangents]
            contents += [brdf(probes[:, None], probes) for brdf in each.gloss]
    if points is not None:
        # What the points gather has bounced already; elsewhere bounces and what reflects enter after tracing.
        contents += [points.receiver_positions, points.receiver_normals]
        contents += [geometry.albedo, geometry.specular, geometry.translucency]
        parameters["bounces"] = bounces
        parameters["media"] = repr([each and (each[0].coefficients, each[0].eta, each[1]) for each in geometry.media])
        parameters["enough"] = job.enough
    with kept_in(folder, contents, parameters) as store:
        yield store


@contextlib.contextmanager
def kept_in(
    folder: Path | str | None, contents: Sequence[Tensor], parameters: dict[str, Any]
) -> Iterator[Checkpoint | ObjectCheckpoint]:
    """A checkpoint of what `contents` and `parameters` decide, at a place or in a temporary folder."""
    store = kept_at(folder, fingerprint(contents, parameters))
    try:
        yield store
    except CannotWrite as fault:
        if folder is not None:
            raise
        raise no_temporary(fault.reason) from fault
    finally:
        store.close()
