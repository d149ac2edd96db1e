"""How long a bake takes on clusters that are not here, and what it waits for: a simulation from measured parts.

`scripts/docs scale` writes the tables and the picture of docs/scale.md with it. What is measured is in `measured.json`
and scales with receivers, rays and workers as `Costs` says. What is assumed is in the constants below and in `Cluster`.
`stage.py` has the queues. A bake goes from part to part as it does in `torchprt.transport`: the client looks at the
scene, the scene goes to all workers, they trace, and once a bounce what surfaces send out goes to all, who gather.
"""

from __future__ import annotations

import json
import math
import random
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stage import Station, Work, busy, makespan

HERE = Path(__file__).parent
CHUNK = 512
# Bytes a second of 10-gigabit Ethernet (IEEE 802.3ae); what a file server on one such link gives all together.
LINK = 10e9 / 8
# Requests a second of one prefix of an object store, and bytes a second of one of them: "Best practices design
# patterns: optimizing Amazon S3 performance" and "Performance guidelines" of the Amazon S3 User Guide.
GETS, PUTS, ONE_REQUEST = 5500.0, 3500.0, 85e6
# Workers that get a copy from each that has one, a round: `branching_factor` of Dask's `Scheduler.replicate`.
BRANCHES = 2
# Cores and bytes of memory of a machine, as usual ones of clouds have: 4 GiB a core.
CORES, MEMORY = 8, 32 * 2**30


@dataclass(frozen=True)
class Costs:
    """What parts of a bake cost, in CPU seconds and bytes, at 1024 rays and order 5 where it depends on these."""

    trace: float  # a receiver
    trace_and_keep: float
    bounce: float
    worker: dict[str, float]  # a chunk, beside the task
    scheduler: dict[str, float]  # a task
    scheduler_per_worker: float  # a task, and worker beyond two
    scheduler_per_byte: float
    client: dict[str, float]  # a task
    client_alone: float  # a receiver, outside of all stages
    arrival: float  # a receiver, on each worker: the scene is read and Embree's tree built
    exit_arrival: float
    scene: float  # bytes a receiver
    exitant: float
    results: float
    hits: float
    held: float  # bytes a receiver in the memory of a worker

    @classmethod
    def read(cls, file: Path = HERE / "measured.json") -> Costs:
        """Those that `measure.py` wrote."""
        found = json.loads(file.read_text())
        count, stages = found["scene"]["receivers"], found["stages"]

        def of(stage: str, name: str) -> float:
            return stages[stage][name]["median"]

        def each(name: str) -> dict[str, float]:
            return {stage: of(stage, name) for stage in stages}

        return cls(
            trace=of("trace", "task seconds a receiver"),
            trace_and_keep=of("trace and keep", "task seconds a receiver"),
            bounce=of("bounce", "task seconds a receiver"),
            worker=each("worker seconds a chunk"),
            scheduler=each("scheduler seconds a chunk"),
            scheduler_per_worker=found["tasks"]["scheduler seconds a task a worker"],
            scheduler_per_byte=found["tasks"]["seconds a byte of results"]["scheduler"]["median"],
            client=each("client seconds a chunk"),
            client_alone=found["client seconds a receiver"]["median"],
            arrival=of("trace", "worker seconds of arrival") / count,
            exit_arrival=of("bounce", "worker seconds of arrival") / count,
            scene=of("trace", "bytes sent") / count,
            exitant=of("bounce", "bytes sent") / count,
            results=of("trace", "bytes back a receiver"),
            hits=found["store"]["bytes a receiver"]["median"],
            held=found["memory"]["bytes a receiver"]["median"],
        )


@dataclass(frozen=True)
class Cluster:
    """Machines, what joins them, and how bakes use them: by default as they are built."""

    workers: int  # cores that compute
    link: float = LINK
    store: float = LINK
    cores: int = CORES
    shared_cores: float = math.inf  # that workers, scheduler and client have all together, on one machine
    chunks_a_task: int = 1
    threads: int = 1  # of a process, which has one copy of the scene
    pass_on_first: bool = False  # before the tree is built, not after
    results_to_store: bool = False
    object_store: bool = False
    schedulers: int = 1
    client_cores: int = 1
    scene_kept: bool = False  # at the workers, until the bake is done
    scene_share: float = 1.0  # of the scene and of what it sends out that a worker needs

    @property
    def processes(self) -> int:
        return math.ceil(self.workers / self.threads)


@dataclass(frozen=True)
class Bake:
    receivers: int
    bounces: int = 2
    rays: int = 1024

    @property
    def chunks(self) -> int:
        return math.ceil(self.receivers / CHUNK)


@dataclass
class Outcome:
    """Seconds of a bake by part, and seconds that each resource is busy."""

    parts: dict[str, float] = field(default_factory=dict)
    busy: dict[str, float] = field(default_factory=dict)
    held: float = 0.0
    machine_held: float = 0.0

    @property
    def seconds(self) -> float:
        return sum(self.parts.values())

    @property
    def use(self) -> dict[str, float]:
        """The share of time that each resource is busy."""
        return {name: each / self.seconds for name, each in self.busy.items()}

    @property
    def efficiency(self) -> float:
        """The share of the time of all cores in which rays are traced and hits gathered."""
        return self.use["workers"]

    @property
    def wall(self) -> str:
        """What is busy for longest."""
        return max(self.busy, key=self.busy.__getitem__)

    @property
    def fits(self) -> bool:
        """Whether a machine has the memory."""
        return self.machine_held <= MEMORY

    def add(self, part: str, seconds: float, used: dict[str, float]) -> None:
        self.parts[part] = self.parts.get(part, 0.0) + seconds
        for name, each in used.items():
            self.busy[name] = self.busy.get(name, 0.0) + each


def rounds(processes: int) -> int:
    """Rounds of a broadcast: each multiplies by three those that have a copy."""
    return math.ceil(round(math.log(processes, 1 + BRANCHES), 9)) if processes > 1 else 0


def broadcast(size: float, arrival: float, cluster: Cluster) -> tuple[float, float]:
    """Seconds until all processes have `size` bytes, and how many of them are on the way.

    As `Scheduler.scatter` and `replicate` of Dask do: by way of the scheduler to one worker, then in rounds, each of
    which ends when all its copies are there; who copies from whom is chosen at random. `arrival`: seconds of a worker
    until it has made of it what it holds, and can pass it on.
    """
    once = size / cluster.link
    if not size:
        return 0.0, 0.0
    per_machine = max(1, cluster.cores // cluster.threads)
    # A seed, so that a cluster has one time.
    chance, have, missing = random.Random(1), [0], list(range(1, cluster.processes))
    way, seconds = 2 * once, 2 * once + arrival
    while missing:
        count = min(len(missing), BRANCHES * len(have))
        chance.shuffle(missing)
        takers, missing = missing[:count], missing[count:]
        out, into = dict[int, int](), dict[int, int]()
        for taker in takers:
            source, target = chance.choice(have) // per_machine, taker // per_machine
            if source != target:
                out[source] = out.get(source, 0) + 1
                into[target] = into.get(target, 0) + 1
        # Links carry both ways at once.
        taken = once * max([0, *out.values(), *into.values()])
        way, seconds = way + taken, seconds + taken + (0.0 if cluster.pass_on_first else arrival)
        have += takers
    return seconds + (arrival if cluster.pass_on_first and cluster.processes > 1 else 0.0), way


def stage(name: str, bake: Bake, cluster: Cluster, costs: Costs) -> tuple[float, dict[str, float]]:
    """Seconds of a stage, and for how long what is busy in it."""
    # No task has so many chunks that workers are without.
    chunks_a_task = max(1, min(cluster.chunks_a_task, bake.chunks // (4 * cluster.workers)))
    tasks, each = math.ceil(bake.chunks / chunks_a_task), bake.receivers / math.ceil(bake.chunks / chunks_a_task)
    rays, many = bake.rays / 1024, range(1, cluster.schedulers + 1)
    of_task = {"trace": costs.trace, "trace and keep": costs.trace_and_keep, "bounce": costs.bounce}[name] * rays * each
    own = costs.worker[name] * chunks_a_task
    back, hits = costs.results * each, costs.hits * rays * each
    of_scheduler = costs.scheduler[name] + costs.scheduler_per_worker * max(0, cluster.workers / len(many) - 2)
    read = hits if name == "bounce" else 0.0
    write = (hits if name == "trace and keep" else 0.0) + (back if cluster.results_to_store else 0.0)
    by_way = 0.0 if cluster.results_to_store else back
    work = Work(
        before=[Station("scheduler", of_scheduler + costs.scheduler_per_byte * by_way, cluster.schedulers)],
        reading=_stored(read, chunks_a_task, GETS, cluster),
        seconds=of_task + own,
        writing=_stored(write, chunks_a_task, PUTS, cluster),
        after=[
            Station("network", by_way / cluster.link, cluster.schedulers),
            Station("client", costs.client[name], cluster.schedulers),
        ],
    )
    used = busy(tasks, work.stations)
    used["workers"] = tasks * of_task / cluster.workers
    every = tasks * (of_task + own) + sum(cluster.schedulers * used[which] for which in ("scheduler", "client"))
    return max(makespan(tasks, cluster.workers, work), every / cluster.shared_cores), used


def _stored(size: float, objects: int, requests: float, cluster: Cluster) -> list[Station]:
    if not size:
        return []
    if cluster.object_store:
        # Each thread waits for its own requests, and all for the store's.
        one = Station("one request", size / ONE_REQUEST, cluster.workers)
        return [Station("store", objects / requests), one]
    return [Station("store", size / cluster.store)]


def simulate(bake: Bake, cluster: Cluster, costs: Costs) -> Outcome:
    """A whole bake."""
    found, count = Outcome(), bake.receivers * cluster.scene_share
    alone = bake.receivers * costs.client_alone / cluster.client_cores

    def send(part: str, size: float, arrival: float) -> None:
        seconds, way = broadcast(size * count, arrival * count, cluster)
        found.add(part, seconds, {"network": way, "arrival": seconds - way})

    found.add("client", alone, {"client": alone})
    send("scene", costs.scene, costs.arrival)
    found.add("trace", *stage("trace and keep" if bake.bounces else "trace", bake, cluster, costs))
    for _ in range(bake.bounces):
        send("exit radiance", costs.exitant, costs.exit_arrival)
        found.add("bounces", *stage("bounce", bake, cluster, costs))
    # The estimate of the error traces a few again: workers have forgotten the scene, and the sum of several bounces is
    # a gather from another exit radiance.
    if bake.bounces and not cluster.scene_kept:
        send("scene", costs.scene, costs.arrival)
    if bake.bounces > 1:
        send("exit radiance", costs.exitant, costs.exit_arrival)
    found.held = costs.held * count
    found.machine_held = found.held * max(1, cluster.cores // cluster.threads)
    found.busy.pop("one request", None)
    return found


# What would move the walls, by name, in the order in which it is tried.
REMEDIES: dict[str, dict[str, Any]] = {
    "16 chunks a task": {"chunks_a_task": 16},
    "one process of 8 threads a machine": {"threads": CORES},
    "passed on before the tree is built": {"pass_on_first": True},
    "scene sent once": {"scene_kept": True},
    "client's own work on 8 cores": {"client_cores": CORES},
    "ten file servers": {"store": 10 * LINK},
}
# Others, which change what is computed or what it runs on.
FURTHER: dict[str, dict[str, Any]] = {
    "hits in an object store": {"object_store": True},
    "results to the store": {"results_to_store": True},
    "two schedulers, two clients": {"schedulers": 2},
    "a tenth of the scene a worker": {"scene_share": 0.1},
}
TOGETHER = {name: value for each in REMEDIES.values() for name, value in each.items()}
