"""The tasks of a bake with glossy receivers: diffuse and glossy from one set of traced rays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from jaxtyping import Float
from torch import Tensor

from torchprt.transport.diffuse_tasks import Job, TracingTask
from torchprt.transport.directions import hemisphere
from torchprt.transport.glossy import Arrivals, Exitant, Glossy, Tables, gathered, shadowed, tables
from torchprt.transport.rows import Recording
from torchprt.transport.task import Once, Results
from torchprt.transport.validity import Validity

# Matrices that are recorded: those that are wanted, or those that surfaces are shaded from when they are hit.
Recorded = Literal["wanted", "for hits"]


@dataclass
class GlossyJob:
    """What a glossy bake is made of: the job of all receivers, which of them are glossy, and what they record.

    `albedo [V, 1 or 3]`, `specular [G, 1 or 3]`: what surfaces that are hit reflect.
    `hit`: the glossy receivers of these surfaces, if others record.
    """

    job: Job
    glossy: Glossy
    recording: Recording
    albedo: Float[Tensor, "V A"]
    specular: Float[Tensor, "G S"]
    validity: Validity | None = None
    """That of the glossy receivers among themselves."""
    hit: Glossy | None = None
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    def filled(self, matrix: Float[Tensor, "G R W"]) -> Float[Tensor, "G R W"]:
        """What arrives at the glossy receivers, in place: those that see nothing have it from their neighbours."""
        if self.validity is not None:
            self.validity.fill(matrix.view(len(matrix), -1))
        return matrix

    def recording_of(self, recorded: Recorded) -> Recording:
        """What is recorded for one of the two uses."""
        return self.recording if recorded == "wanted" else self.recording.for_hits()

    def tables(self, rays: int, seed: int, *recorded: Recorded) -> list[Tables]:
        """Tables of recordings along a set of directions."""

        def make() -> list[Tables]:
            directions, order = hemisphere(rays, seed), self.job.order
            return [tables(directions, order, self.recording_of(each), self.glossy.brdfs) for each in recorded]

        return self.once((rays, seed, recorded), make)


@dataclass(frozen=True)
class GlossyTrace(TracingTask):
    """Shadowed "transfer" `[A, N, v]`, and matrices "matrix0" `[g, R, A * N]`, "matrix1", ... of what is `recorded`,
    and "cut", all as in `Trace`; with `keep_hits` also the fields of `Arrivals`, for bounces."""

    recorded: tuple[Recorded, ...]
    keep_hits: bool = False
    for_later = tuple(Arrivals.__dataclass_fields__)

    def compute(self, task: GlossyJob) -> dict[str, Tensor]:
        job, first, *more = task.job, *task.tables(self.rays, self.seed, *self.recorded)
        direct, matrices, arrivals, cut = shadowed(
            job.tracer,
            job.surfaces,
            job.receivers[self.index],
            task.glossy.material[self.index],
            first,
            *(each.rows for each in more),
            keep_hits=self.keep_hits,
        )
        contents = {f"matrix{number}": matrix for number, matrix in enumerate(matrices)}
        if job.surfaces.mirrors is not None:
            contents["cut"] = cut
        return {"transfer": direct, **contents, **({} if arrivals is None else vars(arrivals))}


@dataclass(frozen=True)
class GlossyRecord(TracingTask):
    """Vectors "transfer" `[v, C * N]` and, where receivers are glossy, "matrix" `[g, R, C * N]`: direct light plus one
    gather of what the surfaces that are hit send out, if they do; traced anew."""

    def compute(self, task: GlossyJob, sent: Exitant | None) -> dict[str, Tensor]:
        job, (set_of,) = task.job, task.tables(self.rays, self.seed, "wanted")
        some, material = job.receivers[self.index], task.glossy.material[self.index]
        direct, (matrix,), arrivals, _ = shadowed(
            job.tracer, job.surfaces, some, material, set_of, keep_hits=sent is not None
        )
        more = job.channels // len(direct)
        diffuse, matrix = direct.permute(2, 0, 1).flatten(1).repeat(1, more), matrix.repeat(1, 1, more)
        if sent is not None and arrivals is not None:
            other, further = gathered(arrivals, sent, task.hit or task.glossy, job.surfaces, some, material, set_of)
            diffuse, matrix = diffuse + other, matrix + further
        return {"transfer": diffuse, **({"matrix": matrix} if len(matrix) else {})}


@dataclass(frozen=True)
class GlossyBounce(TracingTask):
    """What is "arriving" `[v, C * N]` at chunk `number` and its "matrix" `[g, R, C * N]`: one gather of what all
    receivers send out, from stored hits of the rays that were traced."""

    recorded: Recorded
    number: int

    @property
    def work(self) -> int:
        return self.count

    def compute(self, task: GlossyJob, sent: Exitant, store: Results) -> dict[str, Tensor]:
        (set_of,) = task.tables(self.rays, self.seed, self.recorded)
        kept = store.read(self.number)
        arrivals = Arrivals(*(kept[name] for name in Arrivals.__dataclass_fields__))
        some, material = task.job.receivers[self.index], task.glossy.material[self.index]
        arriving, matrix = gathered(arrivals, sent, task.glossy, task.job.surfaces, some, material, set_of)
        return {"arriving": arriving, "matrix": matrix}
