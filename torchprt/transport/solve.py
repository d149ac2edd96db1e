"""Transport over all receivers: trace every chunk once, then bounce until enough light has come."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.progress import Report
from torchprt.scene import Geometry
from torchprt.trace import Tracer
from torchprt.transport.bounce import Gather, Surfaces, shadowed_with_hits
from torchprt.transport.checkpoint import Checkpoint
from torchprt.transport.diffuse import projection, shadowed
from torchprt.transport.directions import hemisphere
from torchprt.transport.membrane import Sheets
from torchprt.transport.receivers import Receivers
from torchprt.transport.workers import Workers, chunks

# Light that bounces without end is followed until a bounce adds less than this part of the transfer (RMS).
ENERGY = 1e-4


@dataclass
class Job:
    """What a bake is made of, and nothing that changes while it runs."""

    tracer: Tracer
    surfaces: Surfaces
    receivers: Receivers
    order: int
    rays: int
    seed: int
    channels: int
    sheets: Sheets | None = None

    def through(self, arriving: Float[Tensor, "V W"]) -> Float[Tensor, "V W"]:
        """What arrives at all receivers, with what shines through membranes."""
        return arriving if self.sheets is None else self.sheets.through(arriving)

    def directions(self) -> tuple[Float[Tensor, "D 3"], Float[Tensor, "N D"]]:
        """The directions of every receiver and the matrix that projects what they see."""
        directions = hemisphere(self.rays, self.seed)
        return directions, projection(directions, self.order)


@dataclass
class Solution:
    """`transfer [C, N, V]`; `arriving`, the same without what shines through membranes; `exitant [V, C * N]`, what
    its last bounce gathered from (None without one)."""

    transfer: Tensor
    arriving: Tensor
    exitant: Tensor | None = None
    bounces: int = 0


def surfaces(geometry: Geometry) -> Surfaces:
    """Which receivers reflect at the corners of the faces of a scene."""
    return Surfaces(geometry.receiver_of_vertex[geometry.faces], geometry.back_receiver_of_vertex[geometry.faces])


def vertex_receivers(geometry: Geometry, tracer: Tracer) -> Receivers:
    """The receivers of a scene with the origins of their rays."""
    size, inward = _around_vertices(geometry)
    points, normals = geometry.receiver_positions, geometry.receiver_normals
    on_receivers = torch.zeros(len(points), dtype=torch.float64)
    away = torch.zeros_like(points)
    for numbering in (geometry.receiver_of_vertex, geometry.back_receiver_of_vertex):
        recording = numbering >= 0
        on_receivers[numbering[recording]] = size[recording]
        away[numbering[recording]] = inward[recording]
    # Where a wall stands on a floor, the edge of the floor lies in the wall, which would block every ray or none as
    # rounding will have it. A step toward the middle of its own faces, as small as that off the surface, decides.
    away = away - (away * normals).sum(-1, keepdim=True) * normals + normals
    return Receivers(points, normals, tracer.origins(points, away, on_receivers))


def _around_vertices(geometry: Geometry) -> tuple[Float[Tensor, "Vall"], Float[Tensor, "Vall 3"]]:
    """Longest extent of the faces at each vertex, and the mean direction to their middles (short unless at an edge)."""
    # Axis by axis: at a million vertices the corners of all faces at once would weigh as much as the transfer.
    extent = torch.zeros(len(geometry.faces), dtype=torch.float64)
    for axis in geometry.positions.unbind(-1):
        corners = axis[geometry.faces]
        torch.maximum(extent, corners.amax(1) - corners.amin(1), out=extent)
    size = torch.zeros(len(geometry.positions), dtype=torch.float64)
    total, count = torch.zeros_like(geometry.positions), torch.zeros_like(size)
    first, second, third = (geometry.positions[corner] for corner in geometry.faces.unbind(-1))
    middle = (first + second + third) / 3
    for corner in geometry.faces.unbind(-1):
        size = size.scatter_reduce(0, corner, extent, "amax")
        to_middle = torch.nn.functional.normalize(middle - geometry.positions[corner], dim=-1)
        total.index_add_(0, corner, to_middle)
        count.index_add_(0, corner, torch.ones_like(extent))
    return size, total / count.clamp(min=1)[:, None]


def exit_radiance(transfer: Float[Tensor, "C N V"], albedo: Float[Tensor, "V D"]) -> Float[Tensor, "V W"]:
    """Transfer times albedo, vertices first so that a hit reads one row, channels and coefficients side by side."""
    factors = albedo.expand(-1, len(transfer)) if len(transfer) > 1 else albedo[:, :1]
    return (transfer.permute(2, 0, 1) * factors[:, :, None]).flatten(1)


def solve(
    job: Job,
    albedo: Float[Tensor, "V D"],
    bounces: int | float,
    store: Checkpoint | None,
    workers: Workers,
    report: Report,
) -> Solution:
    """Transfer of all receivers of `job`, which are those that reflect; bounces need a `store` for their hits."""
    direct = trace(job, store, workers, report, keep_hits=bounces > 0)
    if not bounces:
        return Solution(job.through(direct.T).T[None], direct[None])
    assert store is not None
    everything = chunks(len(job.receivers))
    # From here on vertices first; the layout that shades again at the end.
    total = direct.expand(job.channels, -1, -1).permute(2, 0, 1).flatten(1).contiguous()
    scale = exit_radiance(torch.ones(job.channels, job.order**2, 1).expand(-1, -1, len(total)), albedo)
    added, count = total, 0
    while count < bounces:
        exitant = scale * job.through(added)

        def bounce(index: int, exitant: Tensor = exitant) -> tuple[int, Tensor]:
            return index, _kept_gather(store, index) @ exitant

        report.start(f"bounce {count + 1}", len(job.receivers))
        added = torch.empty_like(total)
        for index, part in workers.map(bounce, range(len(everything))):
            added[everything[index]] = part
            report.advance(len(part))
        # The sum of all bounces is one more gather from the sum of all but the last.
        sent = scale * job.through(total)
        total = total + added
        count += 1
        if bounces == math.inf and added.norm() <= ENERGY * total.norm():
            break
    arriving = channels_first(total, job.channels)
    shown = arriving if job.sheets is None else channels_first(job.through(total), job.channels)
    return Solution(shown, arriving, sent, count)


def channels_first(rows: Float[Tensor, "V W"], channels: int) -> Float[Tensor, "C N V"]:
    """Vectors with vertices first as the layout that shades."""
    return rows.view(len(rows), channels, -1).permute(1, 2, 0).contiguous()


def trace(
    job: Job, store: Checkpoint | None, workers: Workers, report: Report, *, keep_hits: bool
) -> Float[Tensor, "N V"]:
    """Shadowed transfer of every chunk that the store does not hold yet; with `keep_hits` the store gets the hits."""
    everything = chunks(len(job.receivers))
    directions, project = job.directions()
    transfer = torch.empty(job.order**2, len(job.receivers))

    def one(index: int) -> dict[str, Tensor]:
        receivers = job.receivers[everything[index]]
        if not keep_hits:
            return {"transfer": shadowed(job.tracer, receivers, directions, project)}
        part, gather = shadowed_with_hits(job.tracer, job.surfaces, receivers, directions, project)
        return {"transfer": part, **vars(gather)}

    def take(index: int, contents: dict[str, Tensor]) -> None:
        transfer[:, everything[index]] = contents["transfer"]

    every_chunk(len(job.receivers), job.rays, one, take, store, workers, report)
    return transfer


def every_chunk(
    count: int,
    rays: int,
    one: Callable[[int], dict[str, Tensor]],
    take: Callable[[int, dict[str, Tensor]], None],
    store: Checkpoint | None,
    workers: Workers,
    report: Report,
    *,
    stage: str = "trace",
    first: int = 0,
) -> None:
    """Computes with `one` every chunk of `count` receivers that the store does not hold yet, and keeps it there; all
    go to `take`. In the store chunks are numbered from `first`."""
    everything = chunks(count)
    missing, left = [], 0
    for index, rows in enumerate(everything):
        found = None if store is None else store.load(first + index)
        if found is None:
            missing.append(index)
            left += rows.stop - rows.start
        else:
            take(index, found)

    def traced(index: int) -> tuple[int, dict[str, Tensor]]:
        contents = one(index)
        if store is not None:
            store.save(first + index, contents)
        return index, contents

    report.start(stage, rays * count, rays * (count - left))
    for index, contents in workers.map(traced, missing):
        take(index, contents)
        report.advance(rays * (everything[index].stop - everything[index].start))


def gathered(
    job: Job, rows: slice | Tensor, exitant: Tensor | None, directions: Tensor, project: Tensor
) -> Float[Tensor, "C N v"]:
    """Shadowed transfer of some receivers plus one gather of what the surfaces around them send out."""
    receivers = job.receivers[rows]
    if exitant is None:
        return shadowed(job.tracer, receivers, directions, project).expand(job.channels, -1, -1)
    direct, gather = shadowed_with_hits(job.tracer, job.surfaces, receivers, directions, project)
    return direct + (gather @ exitant).view(len(receivers), job.channels, -1).permute(1, 2, 0)


def kept(store: Checkpoint, index: int) -> dict[str, Tensor]:
    """What the store has of a chunk that was traced."""
    contents = store.load(index)
    if contents is None:
        raise InputError(f"{store.path(index)} vanished or was damaged during the bake: run it again")
    return contents


def _kept_gather(store: Checkpoint, index: int) -> Gather:
    contents = kept(store, index)
    return Gather(contents["offsets"], contents["sources"], contents["weights"])
