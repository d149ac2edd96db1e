"""The task of a bake around an object: what comes to points in the space around it, from all sides."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchprt.trace import Hits
from torchprt.transport.diffuse_tasks import Job, TracingTask
from torchprt.transport.directions import sphere
from torchprt.transport.glossy import Arrivals, Exitant, Glossy, exit_radiance_at, reflecting
from torchprt.transport.mirrors import by_way_of_mirrors
from torchprt.transport.receivers import Receivers
from torchprt.transport.rows import Rows, around
from torchprt.transport.task import Once


@dataclass
class Around:
    """What a bake around an object is made of: the `job` of the object itself, and where light is recorded.

    `glossy`: which receivers of the object are, none at all if it is diffuse. `sent`: what they send out, or None if
    nothing bounces.
    """

    job: Job
    points: Float[Tensor, "V 3"]
    output_order: int
    glossy: Glossy
    sent: Exitant | None = None
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    def tables(self, rays: int, seed: int) -> tuple[Float[Tensor, "D 3"], Rows]:
        """The directions of every node and the rows that they are weighted with."""

        def make() -> tuple[Tensor, Rows]:
            directions = sphere(rays, seed)
            return directions.to(torch.float32), around(directions, self.job.order, self.output_order)

        return self.once((rays, seed), make)

    def receivers(self, index: slice | Tensor) -> Receivers:
        """Nodes as what traces rays takes them: without a normal, their frames those of the object."""
        points = self.points[index]
        return Receivers(points, torch.zeros_like(points), self.job.tracer.local(points).to(torch.float32))


@dataclass(frozen=True)
class Surround(TracingTask):
    """The "matrix" `[v, R, C * N]` of nodes, and which lie "inside" `[v]` of the object: none of their rays leaves, and
    a quarter or more end on the back of a surface that has none. With mirrors also what they "cut" `[v]` off."""

    def compute(self, around: Around) -> dict[str, Tensor]:
        job, (directions, rows_of) = around.job, around.tables(self.rays, self.seed)
        nodes, mirrors = around.receivers(self.index), job.surfaces.mirrors
        turned = torch.eye(3).expand(len(nodes), 3, 3)
        count, columns = len(rows_of.table), job.order**2
        matrix = torch.empty(len(nodes), count, job.channels * columns)
        inside = torch.zeros(len(nodes), dtype=torch.bool)
        cut = torch.zeros(len(nodes))
        entries = rows_of.entries
        assert entries is not None
        for rows in nodes.blocks(len(directions)):
            origins, here = nodes.origins[rows], turned[rows].contiguous()
            size = len(origins)
            hits: Hits | None = None
            if around.sent is None and mirrors is None:
                visible = job.tracer.visibility(origins, here, directions)
                closed = torch.nonzero(visible.sum(1) == 0)[:, 0]
                if len(closed):
                    found = job.tracer.hits(origins[closed], here[closed], directions)
                    inside[rows.start + closed] = _within(job, found)
            else:
                hits = job.tracer.hits(origins, here, directions)
                visible = (hits.triangle < 0).to(torch.float32)
                inside[rows] = (visible.sum(1) == 0) & _within(job, hits)
            direct = (visible @ rows_of.product.T)[:, entries].view(size, count, columns)
            matrix[rows] = direct.repeat(1, 1, job.channels)
            if hits is None:
                continue
            seen = None
            if mirrors is not None:
                seen = by_way_of_mirrors(job.tracer, mirrors, hits, here, directions)
                reflected = rows_of.table @ seen.radiance(job.order, size, len(directions))
                matrix[rows] += reflected.repeat(1, 1, job.channels // job.surfaces.channels)
                cut[rows] = seen.lost(torch.full((len(directions),), 1 / len(directions)), size)
            if around.sent is not None:
                lit = torch.ones(size, dtype=torch.bool)
                arrivals = reflecting(hits, job.surfaces, lit, here, directions, seen)
                matrix[rows] += _sent(around, arrivals, directions, rows_of)
        return {"matrix": matrix, "inside": inside, **({} if mirrors is None else {"cut": cut})}


def _within(job: Job, hits: Hits) -> Bool[Tensor, "v"]:
    """Whether a quarter of the rays that end somewhere end on the back of a surface that has none. All do inside of a
    solid, half of them on its surface."""
    backs = job.surfaces.reflect[1][hits.triangle.clamp(min=0).long()]
    odd = (hits.triangle >= 0) & ~hits.front & ~backs
    return odd.sum(1) > 0.25 * (hits.triangle >= 0).sum(1)


def _sent(
    around: Around, arrivals: Arrivals, directions: Float[Tensor, "D 3"], rows_of: Rows
) -> Float[Tensor, "v R W"]:
    """What the surfaces that rays hit send to a block of nodes. Only rays that hit one are looked at: around an object
    they are few."""
    assert around.sent is not None
    counts, column = arrivals.counts.long(), arrivals.column.long()
    row = torch.repeat_interleave(torch.arange(len(counts)), counts)
    place = torch.arange(len(row)) - (counts.cumsum(0) - counts)[row]
    widest = max(int(counts.max()), 1)
    everything = slice(0, len(row))
    toward = -(arrivals.leg if len(arrivals.leg) else directions[column])
    found = exit_radiance_at(arrivals, everything, toward, around.sent, around.glossy, around.job.surfaces)
    if len(arrivals.leg):
        found = (found.unflatten(1, (arrivals.share.shape[1], -1)) * arrivals.share[..., None]).flatten(1)
    radiance = torch.zeros(len(counts), widest, found.shape[1])
    weights = torch.zeros(len(counts), widest, len(rows_of.table))
    radiance[row, place] = found
    weights[row, place] = rows_of.table.T[column]
    return weights.mT @ radiance
