"""From a scene with glossy materials to its transfer."""

from __future__ import annotations

import dataclasses
import warnings
from typing import Any, Literal

import torch
from torch import Tensor

from torchprt.brdf import exit_error, factor
from torchprt.errors import InputError
from torchprt.scene import Geometry
from torchprt.sh import Projection, exit_count
from torchprt.transfer import Dense, Diffuse, Exit, Factored, Incident, Layer, Transfer, Vertices, Visibility
from torchprt.transport import result
from torchprt.transport.diffuse_tasks import Job
from torchprt.transport.directions import hemisphere
from torchprt.transport.estimate import glossy_error_and_signal
from torchprt.transport.glossy import glossy
from torchprt.transport.glossy_tasks import GlossyJob
from torchprt.transport.receivers import tangent_frames
from torchprt.transport.rows import Recording
from torchprt.transport.solve_glossy import GlossySolution, solve
from torchprt.transport.stages import Stages
from torchprt.transport.tables import Tables, channels_first
from torchprt.transport.visibility import on_the_fly, product_error
from torchprt.version import VERSION

Frame = Literal["exit", "incident", "visibility"]

# Exit radiance that an order represents worse than this (relative RMS) is warned of.
COARSE = 0.1


class OrderWarning(UserWarning):
    """The exit functions are too few for a material."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What a caller wants of glossy receivers: arguments of `bake`."""

    frame: Frame
    output_order: int
    projection: Projection
    factors: int | float | None
    visibility_order: int


def check(wanted: Wanted, geometry: Geometry, bounces: int | float) -> None:
    """Raises InputError if the arguments of `bake` for glossy receivers do not fit each other or the scene."""
    exit_count(wanted.output_order, wanted.projection)
    for name, order in (("output_order", wanted.output_order), ("visibility_order", wanted.visibility_order)):
        if not 1 <= order <= 32:
            raise InputError(f"{name} is {order}: give a number from 1 to 32")
    if wanted.frame not in ("exit", "incident", "visibility"):
        raise InputError(f"frame '{wanted.frame}' is unknown: give 'exit', 'incident' or 'visibility'")
    if wanted.factors is not None and wanted.frame != "exit":
        raise InputError(f"factors go with the frame 'exit', not '{wanted.frame}': leave one of the two out")
    one = "factors" if wanted.factors is not None else "frame 'visibility'" if wanted.frame == "visibility" else ""
    if one and len(geometry.gloss) > 1:
        raise InputError(f"{one} takes one glossy material but there are {len(geometry.gloss)}: bake them apart")
    if wanted.frame == "visibility" and bounces:
        raise InputError("frame 'visibility' holds shadows alone: leave the bounces out, or bake matrices")
    if wanted.frame == "visibility" and len(geometry.reflectance):
        raise InputError("frame 'visibility' cannot hold light that mirrors turned: leave them out, or bake matrices")


def warn_of_order(wanted: Wanted, geometry: Geometry, order: int, bounces: int | float = 0) -> float | None:
    """The largest `exit_error` of the scene's materials; warns if one is coarse. None where no exit function is used,
    neither for what is recorded nor for surfaces that are hit."""
    if not bounces and (wanted.frame == "incident" or wanted.factors is not None):
        return None
    worst = 0.0
    for brdf in geometry.gloss:
        error = exit_error(brdf, wanted.output_order, order, wanted.projection)
        worst = max(worst, error)
        if error > COARSE:
            warnings.warn(
                f"output order {wanted.output_order} cannot hold the material {brdf.spec}: exit radiance errs by "
                f"{error:.0%} (relative RMS, unshadowed, white light of order {order}); raise the output order"
                f"{'' if wanted.projection == 'optimal' else ' or use the optimal projection'}",
                OrderWarning,
                stacklevel=4,
            )
    return worst


def recording_of(wanted: Wanted, geometry: Geometry, order: int) -> Recording:
    """What glossy receivers record for lights of `order`."""
    if wanted.frame == "visibility":
        return Recording("visibility", order, wanted.visibility_order)
    if wanted.factors is not None:
        count = {"rows": wanted.factors} if isinstance(wanted.factors, int) else {"error": wanted.factors}
        chosen = factor(geometry.gloss[0], light_order=order, **count)
        return Recording("factored", order, wanted.output_order, factors=chosen)
    return Recording(wanted.frame, order, wanted.output_order, wanted.projection)


def job_of(job: Job, geometry: Geometry, recording: Recording) -> GlossyJob:
    """The job of all receivers, told which of them are glossy and what they record."""
    tangents = torch.zeros_like(job.receivers.normals)
    tangents[geometry.glossy] = geometry.tangents.to(tangents.dtype)
    receivers = dataclasses.replace(job.receivers, tangents=tangents)
    everything = glossy(receivers, geometry.glossy, geometry.tangents, geometry.gloss_of_glossy, geometry.gloss)
    job = dataclasses.replace(job, receivers=receivers)
    among = None if job.validity is None else job.validity.among(geometry.glossy)
    return GlossyJob(job, everything, recording, geometry.albedo, geometry.specular, among)


def bake_vertices(job: Job, geometry: Geometry, wanted: Wanted, bounces: int | float, stages: Stages) -> Transfer:
    """Transfer at the vertices of a scene that has glossy ones."""
    worst = warn_of_order(wanted, geometry, job.order, bounces)
    task = job_of(job, geometry, recording_of(wanted, geometry, job.order))
    return finished(task, geometry, wanted, solve(task, bounces, stages), worst, stages)


def finished(
    task: GlossyJob,
    geometry: Geometry,
    wanted: Wanted,
    solution: GlossySolution,
    worst: float | None,
    stages: Stages,
) -> Transfer:
    """Transfer of what arrived at the receivers of `geometry`, some of them glossy, with the estimate of its error."""
    job = task.job
    shown = job.through(solution.arrived.diffuse, stages)
    if not solution.bounces and job.channels > job.surfaces.channels:
        job = dataclasses.replace(job, channels=job.surfaces.channels)
        task = dataclasses.replace(task, job=job)
    error, signal = glossy_error_and_signal(task, solution, stages)
    transfer = _transfer(
        geometry,
        wanted,
        task.recording,
        result.vertices(geometry, job.validity),
        shown,
        solution.arrived.matrix,
        worst,
        stages.tables,
        transport="interreflected" if solution.bounces else "shadowed",
        bounces=solution.bounces,
        rays=job.rays,
        seed=job.seed,
        error=error,
        signal=signal,
        cut=solution.cut,
    )
    visible = transfer.layers.get(Visibility.kind)
    if isinstance(visible, Visibility):
        visible.product_error = product_error(
            task, solution.arrived.matrix[..., 0], visible.degree, wanted.output_order, wanted.projection
        )
    return transfer


def bake_unshadowed(geometry: Geometry, wanted: Wanted, order: int, shown: Tensor, tables: Tables) -> Transfer:
    """The closed form at the vertices of a scene that has glossy ones; `shown [V, C * N]` are its diffuse vectors."""
    worst = warn_of_order(wanted, geometry, order)
    normals = geometry.receiver_normals
    recording = recording_of(wanted, geometry, order)
    matrix = tables.empty(len(geometry.glossy), recording.count, recording.columns)
    turned = tangent_frames(normals[geometry.glossy], geometry.tangents).to(torch.float32)
    # The sum over any set of directions is the closed form.
    directions = hemisphere(64)
    for index, brdf in enumerate(geometry.gloss):
        rows = recording.rows(brdf, directions)
        for some in torch.nonzero(geometry.gloss_of_glossy == index)[:, 0].split(1 << 12):
            matrix[some] = rows.unshadowed(turned[some])
    matrix[normals[geometry.glossy].abs().sum(-1) == 0] = 0
    receivers = result.vertices(geometry)
    return _transfer(geometry, wanted, recording, receivers, shown, matrix, worst, tables, transport="unshadowed")


def _transfer(
    geometry: Geometry,
    wanted: Wanted,
    recording: Recording,
    receivers: Vertices,
    shown: Tensor,
    arrived: Tensor,
    worst: float | None,
    tables: Tables,
    **metadata: Any,
) -> Transfer:
    """Transfer of diffuse vectors `shown [V, C * N]` and of the matrices that `arrived [G, R, C * N]`."""
    layers: dict[str, Layer] = {}
    if bool((geometry.albedo > 0).any()) or not len(geometry.glossy):
        diffuse = Dense(values=channels_first(shown, recording.order**2, tables))
        layers["diffuse"] = Diffuse(albedo=result.uniform(geometry.albedo), signal=diffuse)
    if len(geometry.glossy):
        layer = _eye_layer(geometry, wanted, recording, arrived, worst, tables)
        layers[layer.kind] = layer
    return Transfer(receivers=receivers, layers=layers, version=VERSION, **metadata)


def _eye_layer(
    geometry: Geometry,
    wanted: Wanted,
    recording: Recording,
    arrived: Tensor,
    worst: float | None,
    tables: Tables,
) -> Layer:
    """The layer of the matrices or the visibility that `arrived [G, R, C * N]`."""
    common: dict[str, Any] = {
        "receivers": geometry.glossy.to(torch.int32),
        "tangents": geometry.tangents.to(torch.float32),
        "specular": result.uniform(geometry.specular),
        "materials": [brdf.spec for brdf in geometry.gloss],
    }
    exits: dict[str, Any] = {
        "output_order": wanted.output_order,
        "projection": wanted.projection,
        "exit_error": worst,
    }
    if wanted.frame == "visibility":
        kernel, degree = on_the_fly(geometry.gloss[0], recording, wanted.output_order, wanted.projection)
        seen = Dense(values=tables.laid_out(arrived[..., 0].T[None]))
        return Visibility(signal=seen, kernel=kernel, degree=degree, light_order=recording.order, **exits, **common)
    columns = recording.columns
    matrix = arrived.view(-1, recording.count, arrived.shape[2] // columns, columns).permute(2, 0, 1, 3)
    common["signal"] = Dense(values=tables.laid_out(matrix))
    if wanted.frame == "incident":
        return Incident(**common)
    factors = recording.factors
    if factors is not None:
        left = float(factors.errors[factors.rows - 1])
        return Factored(factors=factors.table.to(torch.float32), factor_error=left, **common)
    return Exit(**exits, **common)
