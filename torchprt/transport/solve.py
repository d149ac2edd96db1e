"""Transport over all receivers: trace every chunk once, then bounce until enough light has come."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.trace import Tracer
from torchprt.transfer.pieces import rows
from torchprt.transport.bounce import Surfaces
from torchprt.transport.diffuse_tasks import Bounce, Job, Trace
from torchprt.transport.mirrors import mean_cut, mirrors_of
from torchprt.transport.receivers import Receivers
from torchprt.transport.stages import Stages
from torchprt.transport.tables import Tables, any_of, in_channels
from torchprt.transport.task import chunks
from torchprt.transport.through_volume import ThroughVolume


@dataclass
class Solution:
    """What leaves all receivers, `shown [V, C * N]`, and what arrived there before membranes and bodies changed it,
    `arriving [V, A * N]`; `exitant [V, C * N]`, what its last bounce gathered from (None without one). `cut`: the share
    of light that was left out among mirrors, None if there are none."""

    shown: Tensor
    arriving: Tensor
    exitant: Tensor | None = None
    bounces: int = 0
    cut: float | None = None


def surfaces(geometry: Geometry, volume: ThroughVolume | None = None) -> Surfaces:
    """Which receivers reflect at the corners of the faces of a scene, and what light goes through between them."""
    front, back = geometry.receiver_of_vertex, geometry.back_receiver_of_vertex
    return Surfaces(front[geometry.faces], back[geometry.faces], mirrors_of(geometry), volume)


def vertex_receivers(geometry: Geometry, tracer: Tracer) -> Receivers:
    """The receivers of a scene with the origins of their rays."""
    points, normals = geometry.receiver_positions, geometry.receiver_normals
    size, away = around_receivers(geometry)
    # Where a wall stands on a floor, the edge of the floor lies in the wall, which would block every ray or none as
    # rounding will have it. A step toward the middle of its own faces, as small as that off the surface, decides.
    away = away - (away * normals).sum(-1, keepdim=True) * normals + normals
    return Receivers(points, normals, tracer.origins(points, away, size))


def around_receivers(geometry: Geometry) -> tuple[Float[Tensor, "V"], Float[Tensor, "V 3"]]:
    """Longest extent of the faces at each receiver, and the mean direction to their middles."""
    of_vertices = _around_vertices(geometry)
    size, inward = (values.new_zeros(geometry.receivers, *values.shape[1:]) for values in of_vertices)
    for numbering in (geometry.receiver_of_vertex, geometry.back_receiver_of_vertex):
        recording = numbering >= 0
        size[numbering[recording]] = of_vertices[0][recording]
        inward[numbering[recording]] = of_vertices[1][recording]
    return size, inward


def _around_vertices(geometry: Geometry) -> tuple[Float[Tensor, "Vall"], Float[Tensor, "Vall 3"]]:
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


def exit_radiance(
    leaving: Float[Tensor, "V W"], albedo: Float[Tensor, "V D"], columns: int, tables: Tables
) -> Float[Tensor, "V W"]:
    """Transfer times albedo, vertices first so that a hit reads one row, channels and N `columns` side by side."""
    channels = leaving.shape[1] // columns
    factors = albedo.expand(-1, channels) if channels > 1 else albedo[:, :1]
    found = tables.empty(*leaving.shape)
    for some in rows(*leaving.shape):
        torch.mul(
            leaving[some].unflatten(1, (channels, columns)),
            factors[some, :, None],
            out=found[some].unflatten(1, (channels, columns)),
        )
    return found


def solve(job: Job, albedo: Float[Tensor, "V D"], bounces: int | float, stages: Stages) -> Solution:
    """Transfer of all receivers of `job`, which are those that reflect; bounces need a store for their hits."""
    direct, cut = trace(job, stages, keep_hits=bounces > 0)
    job.filled(direct)
    if not bounces:
        return Solution(job.through(direct, stages), direct, cut=cut)
    assert stages.store is not None
    tables, columns = stages.tables, job.order**2
    tasks = [Bounce(each, number) for number, each in enumerate(chunks(len(job.receivers)))]
    total = in_channels(direct, job.channels * columns // direct.shape[1], tables)
    # Of all that has arrived: it is linear, so that every bounce asks for its own alone.
    leaving = gone = job.through(total, stages)
    count, sent = 0, None
    while count < bounces:
        # Nobody gathers from it any more.
        sent = None
        exitant = exit_radiance(gone, albedo, columns, tables)
        first = gone is leaving
        added = tables.empty(*total.shape)
        for task, found in stages.run(f"bounce {count + 1}", tasks, stages.store, exitant):
            added[task.index] = found["arriving"]
        if bounces == math.inf and not count and not any_of(added):
            # Nothing that rays meet reflects, as around a convex body: none of the bounces is one, nor has it colour.
            return Solution(job.through(direct, stages), direct, cut=cut)
        job.filled(added)
        # The sum of all bounces is one more gather from the sum of all but the last.
        sent = exitant if first else None
        del exitant
        sent = exit_radiance(leaving, albedo, columns, tables) if sent is None else sent
        total += added
        gone = job.through(added, stages)
        if job.changes:
            leaving += gone
        count += 1
        if bounces == math.inf and added.norm() <= job.enough * total.norm():
            break
    return Solution(leaving, total, sent, count, cut)


def trace(job: Job, stages: Stages, *, keep_hits: bool) -> tuple[Float[Tensor, "V W"], float | None]:
    """Shadowed transfer of every chunk that the store does not hold yet, receivers first; with `keep_hits` the store
    gets the hits. The second is what mirrors cut off, as in `Solution`."""
    tasks = [Trace(each, job.rays, job.seed, keep_hits) for each in chunks(len(job.receivers))]
    transfer = stages.tables.empty(len(job.receivers), job.surfaces.channels * job.order**2)
    cut: list[float] = []
    for task, found in stages.run("trace", tasks, job, first=0):
        transfer[task.index] = found["transfer"].permute(2, 0, 1).flatten(1)
        cut += found["cut"].tolist() if "cut" in found else []
    return transfer, mean_cut(cut)
