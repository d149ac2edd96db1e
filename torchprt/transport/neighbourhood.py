"""From an object to what it does to the light around it."""

from __future__ import annotations

import contextlib
import math
import os
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.sparse import coo_matrix, csr_matrix
from torch import Tensor

from torchprt.errors import InputError
from torchprt.progress import Report, Silent
from torchprt.scene import Geometry, Object, Points, Scene
from torchprt.scene.geometry import gather
from torchprt.sh import clamped_cosine, zonal
from torchprt.trace import Tracer
from torchprt.transfer import Dense, Grid, Neighbourhood, Sight, Transfer, grid_in
from torchprt.transport.bake import check_numbers, store_of
from torchprt.transport.bake_glossy import Wanted
from torchprt.transport.bounces import Bounces, followed
from torchprt.transport.checkpoint import place_of
from torchprt.transport.cluster import Cluster, on_clusters
from torchprt.transport.diffuse_tasks import Job
from torchprt.transport.enclosing import SHARE, enclosing_box
from torchprt.transport.estimate import SAMPLE_RAYS
from torchprt.transport.glossy import Exitant, Glossy
from torchprt.transport.membrane import sheets
from torchprt.transport.mirrors import mean_cut, warn_of_cut
from torchprt.transport.neighbourhood_tasks import Around, Surround
from torchprt.transport.points import among, sent_by_glossy
from torchprt.transport.progress import Bar
from torchprt.transport.sight import with_sight
from torchprt.transport.solve import exit_radiance, solve, surfaces, vertex_receivers
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface import bodies_of
from torchprt.transport.tables import in_channels
from torchprt.transport.task import Runner, chunks
from torchprt.transport.validity import along
from torchprt.transport.workers import Threads, torch_on_one_thread
from torchprt.version import VERSION

if TYPE_CHECKING:
    from distributed import Client

COARSE = 0.025
"""Interpolation errors that are warned of."""
# Cells whose middle is baked to find that error, and nodes that are traced again to find that of the rays.
_CELLS, _NODES = 512, 32
# Points of the surface for the area of the smallest side of a cell.
_DENSITY = 16


NODES = 1 << 15
"""As the paper has: 64 x 64 x 8."""
_LARGEST = 1 << 24


class GridWarning(UserWarning):
    """The grid around an object is too coarse for what it does there."""


@on_clusters
@torch_on_one_thread()
def bake_neighbourhood(
    scene: Scene | Sequence[Object],
    *,
    order: int = 5,
    output_order: int = 3,
    grid: int | Sequence[int] = NODES,
    box: Sequence[float] | None = None,
    share: float = SHARE,
    rays: int = 1024,
    bounces: Bounces = 0,
    seed: int = 0,
    threads: int | None = None,
    runner: Runner | None = None,
    on: Client | Cluster | str | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    keep: bool = False,
    progress: bool | Report = True,
) -> Transfer:
    """What an object, all of a scene, does to the light of a space around it: a layer `Neighbourhood` on a `Grid`.

    Receivers that it has never seen read it at run time: `shade.NeighbourhoodShader`. `scene` may also be objects of
    which none records, such as blockers or mirrors alone.

    - `order` of the light; `output_order` of the radiance that arrives, no larger: 3 is enough for diffuse receivers.
    - `grid`: nodes along x, y (up) and z, two or more each, or about how many there are to be in all: their cells are
      then as near to cubes as the box allows. The paper has 64 x 64 x 8, the last upward.
    - `box`: its corners x0, y0, z0, x1, y1, z1 in the frame of the object; if omitted it is found: grown until beyond
      it the object takes less than `share` of the irradiance of a receiver that faces up (`enclosing_box`). `Grid` has
      what came of it.
    - `rays` a node, over the sphere; `bounces`: light that the object reflects to its surroundings, 1 for what comes
      straight from it, or more for what bounces on it first; mirrors reflect without any.
    - `seed`, `threads`, `runner`, `on`, `checkpoint`, `keep`, `progress` as for `bake`.

    Nodes inside of the object are filled from those around them (harmonically, over the grid); `inside` counts them.
    The middles of 512 cells are baked too: `interpolation_error` of the layer is how far what is read between nodes is
    from them, and a `GridWarning` tells if that is above 2.5 %.
    Laws: as for `bake`: the same bits whoever runs it and after any interruption; a node from which nothing of the
    object is seen has the identity. Memory: `4 C G M N` bytes for the result and as much while it is put together.

    Raises InputError if an argument is out of range or does not fit, as `bake`; and if the whole box lies in the
    object.
    Source: Sloan, Kautz and Snyder 2002, section 8.
    """
    check_numbers(order, rays, bounces, True, seed, threads, runner)
    _check(order, output_order, grid, box, share)
    geometry = scene.geometry() if isinstance(scene, Scene) else gather(scene)
    tracer = Tracer(geometry.positions, geometry.faces)
    place = _place(geometry, tracer, grid, box, share)
    count, enough = followed(bounces, geometry, can=True)
    objects = scene.objects if isinstance(scene, Scene) else scene
    coloured = any(each.coloured for each in objects if count or each.material.mirror is not None)
    everything = vertex_receivers(geometry, tracer)
    validity = None
    if count and len(everything):
        with Threads(threads or os.cpu_count() or 1) as workers:
            geometry, everything, validity = with_sight(geometry, tracer, everything, workers)
    channels, membranes = 3 if coloured else 1, sheets(geometry)
    bodies = bodies_of(geometry) if count else ()
    job = Job(tracer, surfaces(geometry), everything, order, rays, seed, channels, membranes, validity, enough, bodies)
    wanted = Wanted("exit", order, "optimal", None, order) if len(geometry.glossy) else None
    positions = place.positions
    points = among(Points(positions, torch.zeros_like(positions)), geometry)
    folder = place_of(checkpoint)
    with contextlib.ExitStack() as stack:
        report: Report = progress if not isinstance(progress, bool) else Silent()
        if progress is True:
            report = stack.enter_context(Bar(engine=tracer.engine))
        more = {"around": output_order}
        store = stack.enter_context(store_of(folder, job, geometry, points, count, wanted, **more))
        if runner is None:
            runner = stack.enter_context(Threads(threads or os.cpu_count() or 1))
        stages = Stages(runner, report, store)
        glossy, sent, done = _sent(job, geometry, wanted, count if len(everything) else 0, stages)
        around = Around(job, positions, output_order, glossy, sent)
        matrix, inside, cut = _recorded(around, stages)
        sight = torch.where(inside, int(Sight.FILLED), int(Sight.VALID)).to(torch.uint8)
        if bool(inside.all()):
            raise InputError("the whole box lies in the object: give a larger one")
        along(_links(place.shape), sight).fill(matrix.view(len(matrix), -1))
        between = _interpolation_error(around, place, matrix, inside, stages)
        error, signal = _error_and_signal(around, matrix, inside, stages)
        if store is not None and not keep:
            store.discard()
    warn_of_cut(cut)
    if between is not None and between > COARSE:
        warnings.warn(
            f"a grid of {'x'.join(map(str, place.shape))} nodes is too coarse: between them radiance near the object "
            f"errs by {between:.1%} (RMS); give more nodes or rays, or a smaller box",
            GridWarning,
            stacklevel=3,
        )
    values = matrix.view(len(matrix), output_order**2, channels, -1).permute(2, 0, 1, 3).contiguous()
    layer = Neighbourhood(signal=Dense(values=values), inside=int(inside.sum()), interpolation_error=between)
    return Transfer(
        receivers=place,
        layers={layer.kind: layer},
        transport="interreflected" if done else "shadowed",
        bounces=done,
        rays=rays,
        seed=seed,
        error=error,
        signal=signal,
        version=VERSION,
        cut=cut,
    )


def _check(order: int, output_order: int, grid: int | Sequence[int], box: Sequence[float] | None, share: float) -> None:
    if not 1 <= output_order <= order:
        raise InputError(f"output_order is {output_order}: give a number from 1 to {order}, the order of the light")
    if isinstance(grid, int):
        if not 8 <= grid <= _LARGEST:
            raise InputError(f"grid is {grid}: give a number of nodes from 8 to {_LARGEST}, or three counts")
    elif len(grid) != 3 or not all(count >= 2 for count in grid) or math.prod(grid) > _LARGEST:
        raise InputError(
            f"grid is {'x'.join(map(str, grid))}: give three counts along x, y and z, from 2 each, and {_LARGEST} in "
            "all at most"
        )
    if box is not None and (len(box) != 6 or not all(map(math.isfinite, box))):
        raise InputError(f"box has {len(box)} numbers: give six finite ones, x0, y0, z0, x1, y1, z1")
    if not 0 < share < 1:
        raise InputError(f"share is {share:g}: give a part between 0 and 1, as 0.02")


def _place(
    geometry: Geometry, tracer: Tracer, grid: int | Sequence[int], box: Sequence[float] | None, share: float
) -> Grid:
    known: dict[str, float] = {}
    if box is not None:
        low, high = list(box[:3]), list(box[3:])
    else:
        used = geometry.positions[geometry.faces.flatten().unique()]
        lowest, highest, border = enclosing_box(tracer, used.amin(0), used.amax(0), share)
        low, high, known = lowest.tolist(), highest.tolist(), {"share": share, "border": border}
    return grid_in(low, high, _counts(low, high, grid) if isinstance(grid, int) else grid, **known)


def _counts(low: Sequence[float], high: Sequence[float], nodes: int) -> list[int]:
    """About so many nodes, their cells near to cubes."""
    extents = [max(b - a, 0.0) for a, b in zip(low, high, strict=True)]
    spacing = (math.prod(extents) / nodes) ** (1 / 3)
    return [max(2, round(extent / spacing)) if spacing > 0 else 2 for extent in extents]


def _sent(
    job: Job, geometry: Geometry, wanted: Wanted | None, bounces: int | float, stages: Stages
) -> tuple[Glossy, Exitant | None, int]:
    """Which receivers of the object are glossy, and what all send out after all bounces but the last, with their
    count."""
    nothing = torch.zeros(0, dtype=torch.int64)
    none = torch.full((len(job.receivers),), -1)
    diffuse = Glossy(nothing, none, none, torch.zeros(0, 3, 3), ())
    if not bounces:
        return diffuse, None, 0
    if wanted is not None:
        glossy, sent, done, _ = sent_by_glossy(job, geometry, wanted, bounces, stages)
        return glossy, sent, done
    over = solve(job, geometry.albedo, bounces - 1, stages)
    leaving = in_channels(over.shown, job.channels * job.order**2 // over.shown.shape[1], stages.tables)
    table = exit_radiance(leaving, geometry.albedo, job.order**2, stages.tables)
    if not bool(table.any()):
        return diffuse, None, 0
    return diffuse, Exitant(table, 1), over.bounces + 1


def _recorded(around: Around, stages: Stages) -> tuple[Float[Tensor, "V R W"], Bool[Tensor, "V"], float | None]:
    """The matrices of all nodes, which of them lie inside of the object, and what mirrors cut off."""
    job = around.job
    tasks = [Surround(rows, job.rays, job.seed) for rows in chunks(len(around.points))]
    width = job.channels * job.order**2
    matrix = torch.empty(len(around.points), around.output_order**2, width)
    inside = torch.zeros(len(around.points), dtype=torch.bool)
    cut = torch.zeros(len(around.points), dtype=torch.float64)
    # The store numbers the chunks of the nodes after those of the vertices.
    for task, found in stages.run("around", tasks, around, first=len(chunks(len(job.receivers)))):
        matrix[task.index] = found["matrix"]
        inside[task.index] = found["inside"]
        cut[task.index] = found.get("cut", torch.zeros(task.count)).double()
    around.once.forget()
    return matrix, inside, None if job.surfaces.mirrors is None else mean_cut(cut[~inside].tolist())


def _links(shape: Sequence[int]) -> csr_matrix:
    """Neighbours in the grid, along its three axes."""
    number = np.arange(math.prod(shape)).reshape(shape)
    pairs = [(number[:-1], number[1:]), (number[:, :-1], number[:, 1:]), (number[..., :-1], number[..., 1:])]
    one, other = (np.concatenate([pair[side].ravel() for pair in pairs]) for side in (0, 1))
    both = np.concatenate([one, other]), np.concatenate([other, one])
    return coo_matrix((np.ones(len(both[0])), both), (number.size, number.size)).tocsr()


def _interpolation_error(around: Around, place: Grid, matrix: Tensor, inside: Tensor, stages: Stages) -> float | None:
    """See `Neighbourhood`; None if no cell is free of the object."""
    nx, ny, nz = place.shape
    number = torch.arange(nx * ny * nz).view(nx, ny, nz)
    corners = torch.stack(
        [
            number[i : nx - 1 + i, j : ny - 1 + j, k : nz - 1 + k].flatten()
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
        ]
    )
    whole = torch.nonzero(~inside[corners].any(0) & ~_crossed(around.job.tracer, place))[:, 0]
    order = torch.randperm(len(whole), generator=torch.Generator().manual_seed(around.job.seed))
    chosen = whole[order[:_CELLS]]
    job = around.job
    middles = Around(job, place.places(0.5)[chosen], around.output_order, around.glossy, around.sent)
    tasks = [Surround(rows, job.rays, job.seed) for rows in chunks(len(chosen))]
    axes = torch.cat([torch.eye(3), -torch.eye(3)]).double()
    cosines = zonal(clamped_cosine(around.output_order), axes)
    missed = whole_light = 0.0
    for task, found in stages.run("between", tasks, middles):
        exact = cosines @ found["matrix"].double()
        read = cosines @ matrix[corners[:, chosen[task.index]]].double().mean(0)
        plain = cosines @ _identity(found["matrix"].double(), job.channels)
        lit = ((exact - plain).square().sum((1, 2)) > SHARE**2 * plain.square().sum()) & ~found["inside"]
        missed += float((read - exact)[lit].square().sum())
        whole_light += float(exact[lit].square().sum())
    return math.sqrt(missed / whole_light) if whole_light > 0 else None


def _crossed(tracer: Tracer, place: Grid) -> Bool[Tensor, "cells"]:
    """Cells that the surface of the object passes through, as found at points spread over it: no receiver is there."""
    corners = tracer.corners()
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=-1) / 2
    cells = torch.tensor(place.shape) - 1
    spacing, origin = torch.tensor(place.spacing).double(), torch.tensor(place.origin).double()
    count = int((_DENSITY * area.sum() / spacing.min().square()).clamp(1 << 12, 1 << 20))
    # Every so much of the area one, at a place in its triangle that differs from the last.
    step = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    number = torch.searchsorted(area.cumsum(0), step * area.sum()).clamp(max=len(area) - 1)
    u, v = torch.frac(torch.arange(count, dtype=torch.float64)[:, None] * torch.tensor([0.7548776662, 0.5698402910])).T
    over = (u + v > 1).double()
    u, v = u + over * (1 - 2 * u), v + over * (1 - 2 * v)
    a, b, c = corners[number].unbind(1)
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    at = ((points - origin) / spacing).floor().long()
    at = at[((at >= 0) & (at < cells)).all(-1)]
    found = torch.zeros(tuple(cells.tolist()), dtype=torch.bool)
    found[at[:, 0], at[:, 1], at[:, 2]] = True
    return found.flatten()


def _identity(matrix: Float[Tensor, "v R W"], channels: int) -> Float[Tensor, "R W"]:
    return torch.eye(matrix.shape[1], matrix.shape[2] // channels, dtype=matrix.dtype).repeat(1, channels)


def _error_and_signal(around: Around, matrix: Tensor, inside: Tensor, stages: Stages) -> tuple[float, float]:
    """RMS error of an entry of the matrices, from nodes that are traced again, and RMS of an entry."""
    job, alive = around.job, torch.nonzero(~inside)[:, 0]
    order = torch.randperm(len(alive), generator=torch.Generator().manual_seed(job.seed))
    # Another seed: the reference must not be a refinement of the same set.
    tasks = [
        Surround(tuple(rows.tolist()), SAMPLE_RAYS * job.rays, job.seed + 1) for rows in alive[order[:_NODES]].split(8)
    ]
    sums = [
        float((matrix[task.index] - better["matrix"]).double().square().mean((1, 2)).sum())
        for task, better in stages.run("error", tasks, around)
    ]
    around.once.forget()
    signal = float(torch.linalg.vector_norm(matrix, dtype=torch.float64)) / math.sqrt(matrix.numel())
    return math.sqrt(math.fsum(sums) / sum(task.count for task in tasks)), signal
