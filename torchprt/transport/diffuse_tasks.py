"""The tasks of a diffuse bake: trace, gather from stored hits, or both at once."""

from __future__ import annotations

from dataclasses import dataclass, field

from jaxtyping import Float
from torch import Tensor

from torchprt.trace import Tracer
from torchprt.transport.bounce import Gather, Surfaces, shadowed_with_hits
from torchprt.transport.bounces import SPENT
from torchprt.transport.diffuse import projection, shadowed
from torchprt.transport.directions import hemisphere
from torchprt.transport.membrane import Sheets
from torchprt.transport.receivers import Receivers
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface import Body, diffused
from torchprt.transport.task import Once, Results, Task
from torchprt.transport.validity import Validity


@dataclass
class Job:
    """What a bake is made of, and nothing that changes while it runs.

    `enough`: endless bounces end when one adds less than this part of the transfer (RMS)."""

    tracer: Tracer
    surfaces: Surfaces
    receivers: Receivers
    order: int
    rays: int
    seed: int
    channels: int
    sheets: Sheets | None = None
    validity: Validity | None = None
    enough: float = SPENT
    bodies: tuple[Body, ...] = ()
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    @property
    def changes(self) -> bool:
        """Whether anything leaves elsewhere than where it arrives."""
        return self.sheets is not None or bool(self.bodies)

    def through(self, arriving: Float[Tensor, "V W"], stages: Stages) -> Float[Tensor, "V D"]:
        """What diffuse surfaces reflect of what arrives at all receivers: with what shines through membranes, and what
        has diffused in bodies. Where there are bodies it has all `channels`, whatever came."""
        found = arriving if self.sheets is None else self.sheets.through(arriving, stages.tables)
        if not self.bodies:
            return found
        channels = arriving.shape[1] // self.order**2
        found = found.repeat(1, self.channels // channels)
        for body in self.bodies:
            found[body.rows] = diffused(body, arriving[body.rows], channels, stages)
        return found

    def filled(self, arriving: Float[Tensor, "V W"]) -> Float[Tensor, "V W"]:
        """What arrives at all receivers, in place: those that see nothing have it from their neighbours."""
        if self.validity is not None:
            self.validity.fill(arriving)
        return arriving

    def directions(self, rays: int, seed: int) -> tuple[Float[Tensor, "D 3"], Float[Tensor, "N D"]]:
        """The directions of every receiver and the matrix that projects what they see."""

        def make() -> tuple[Tensor, Tensor]:
            directions = hemisphere(rays, seed)
            return directions, projection(directions, self.order)

        return self.once((rays, seed), make)


@dataclass(frozen=True)
class TracingTask(Task):
    """A task that traces `rays` a receiver; see `hemisphere` for `seed`."""

    rays: int
    seed: int

    @property
    def work(self) -> int:
        return self.count * self.rays


@dataclass(frozen=True)
class Trace(TracingTask):
    """Shadowed "transfer" `[A, N, v]`, A = 3 if some of it came by way of coloured mirrors or cells; what was "cut" off
    among mirrors, if there are any, `[v]`; with `keep_hits` also the fields of `Gather`, for bounces."""

    keep_hits: bool = False
    for_later = tuple(Gather.__dataclass_fields__)

    def compute(self, job: Job) -> dict[str, Tensor]:
        some = job.receivers[self.index]
        directions, project = job.directions(self.rays, self.seed)
        if not self.keep_hits and not job.surfaces.sent:
            return {"transfer": shadowed(job.tracer, some, directions, project, job.surfaces.volume)[None]}
        direct, gather, cut = shadowed_with_hits(job.tracer, job.surfaces, some, directions, project)
        found = {"transfer": direct} if job.surfaces.mirrors is None else {"transfer": direct, "cut": cut}
        return found | vars(gather) if self.keep_hits else found


@dataclass(frozen=True)
class Record(TracingTask):
    """Shadowed "transfer" `[C, N, v]` plus one gather of what all receivers send out, if they do; traced anew."""

    def compute(self, job: Job, exitant: Float[Tensor, "V W"] | None) -> dict[str, Tensor]:
        some = job.receivers[self.index]
        directions, project = job.directions(self.rays, self.seed)
        if exitant is None and not job.surfaces.sent:
            direct = shadowed(job.tracer, some, directions, project, job.surfaces.volume)
            return {"transfer": direct.expand(job.channels, -1, -1)}
        direct, gather, _ = shadowed_with_hits(job.tracer, job.surfaces, some, directions, project)
        if exitant is None:
            return {"transfer": direct.expand(job.channels, -1, -1)}
        return {"transfer": direct + (gather @ exitant).view(len(some), job.channels, -1).permute(1, 2, 0)}


@dataclass(frozen=True)
class Bounce(Task):
    """What is "arriving" `[v, W]` at chunk `number`: one gather of what all receivers send out, from stored hits."""

    number: int

    def compute(self, store: Results, exitant: Float[Tensor, "V W"]) -> dict[str, Tensor]:
        kept = store.read(self.number)
        return {"arriving": Gather(*(kept[name] for name in Gather.__dataclass_fields__)) @ exitant}
