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
from collections import Counter
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
# Processes that what is shared comes to one after the other where there are two workers: the scheduler and both.
HOPS = 3
# Seconds and bytes of results that go together, as in `torchprt.transport.cluster`.
SPAN, BATCH_BYTES = 0.5, 1 << 24
# Cores and bytes of memory of a machine, as usual ones of clouds have: 4 GiB a core.
CORES, MEMORY = 8, 32 * 2**30


@dataclass(frozen=True)
class Costs:
    """What parts of a bake cost, in CPU seconds and bytes, at 1024 rays and order 5 where it depends on these."""

    task: dict[str, float]  # a receiver, by stage: "trace", "trace and keep", "bounce"
    worker: dict[str, float]  # a chunk, beside its task
    client: dict[str, float]  # a chunk, beside its batch
    client_batch: float
    client_alone: float  # a receiver, outside of all stages
    scheduler_batch: float
    scheduler_batch_worker: float  # a batch, and worker beyond two
    scheduler_byte: float
    arrival: float  # a receiver, at each worker: the scene is made anew, and Embree's tree
    exit_arrival: float
    scene: float  # bytes a receiver
    exitant: float
    results: float
    hits: float
    held: float  # bytes a receiver in the memory of a worker
    hop: float  # seconds a byte of what is shared from one process to the next, without a cable

    @classmethod
    def read(cls, file: Path = HERE / "measured.json") -> Costs:
        """Those that `measure.py` wrote."""
        found = json.loads(file.read_text())
        count, stages, tasks = found["scene"]["receivers"], found["stages"], found["tasks"]

        def of(stage: str, name: str) -> float:
            return stages[stage][name]["median"]

        def each(name: str) -> dict[str, float]:
            return {stage: of(stage, name) for stage in stages}

        batch = tasks["client seconds a task"]["median"]
        share = {stage: of(stage, "batches") / of(stage, "chunks") for stage in stages}
        return cls(
            task=each("task seconds a receiver"),
            worker=each("worker seconds a chunk"),
            client={s: max(0.0, found - share[s] * batch) for s, found in each("client seconds a chunk").items()},
            client_batch=batch,
            client_alone=found["client seconds a receiver"]["median"],
            scheduler_batch=tasks["scheduler seconds a task"],
            scheduler_batch_worker=tasks["scheduler seconds a task a worker"],
            scheduler_byte=tasks["seconds a byte of results"]["scheduler"]["median"],
            arrival=of("trace", "worker seconds of arrival") / count,
            exit_arrival=of("bounce", "worker seconds of arrival") / count,
            scene=of("trace", "bytes sent") / count,
            exitant=of("bounce", "bytes sent") / count,
            results=of("trace", "bytes back a receiver"),
            hits=found["store"]["bytes a receiver"]["median"],
            held=found["memory"]["bytes a receiver"]["median"],
            hop=of("trace", "wall seconds of sending") / of("trace", "bytes sent") / HOPS,
        )


@dataclass(frozen=True)
class Cluster:
    """Machines, what joins them, and how bakes use them: by default as they are built."""

    workers: int  # cores that compute
    link: float = LINK
    store: float = LINK
    cores: int = CORES
    shared_cores: float = math.inf  # that workers, scheduler and client have all together, on one machine
    span: float = SPAN
    threads: int = 1  # of a process, which has one copy of the scene
    results_to_store: bool = False
    object_store: bool = False
    schedulers: int = 1
    client_cores: int = 1
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


def broadcast(size: float, cluster: Cluster, hop: float = 0.0) -> float:
    """Seconds until all processes have `size` bytes.

    As `Scheduler.scatter` and `replicate` of Dask do: by way of the scheduler to one worker, then in rounds, each of
    which ends when all its copies are there; who copies from whom is chosen at random. `hop`: seconds a byte that a
    process needs to pass it on.
    """
    if not size:
        return 0.0
    once, itself = size / cluster.link, size * hop
    per_machine = max(1, cluster.cores // cluster.threads)
    # A seed, so that a cluster has one time.
    chance, have, missing = random.Random(1), [0], list(range(1, cluster.processes))
    seconds = 2 * max(once, itself)
    while missing:
        count = min(len(missing), BRANCHES * len(have))
        chance.shuffle(missing)
        takers, missing = missing[:count], missing[count:]
        out, into, passed = Counter[int](), Counter[int](), Counter[int]()
        for taker in takers:
            source = chance.choice(have)
            passed[source] += 1
            if source // per_machine != taker // per_machine:
                out[source // per_machine] += 1
                into[taker // per_machine] += 1
        # Links carry both ways at once.
        cables = max(0, *out.values(), *into.values()) if out else 0
        seconds += max(once * cables, itself * max(passed.values()))
        have += takers
    return seconds


def stage(name: str, bake: Bake, cluster: Cluster, costs: Costs) -> tuple[float, dict[str, float]]:
    """Seconds of a stage, and for how long what is busy in it."""
    each = min(CHUNK, bake.receivers)
    rays, many = bake.rays / 1024, cluster.schedulers
    task = costs.task[name] * rays * each
    back, hits = costs.results * each, costs.hits * rays * each
    read = hits if name == "bounce" else 0.0
    write = (hits if name == "trace and keep" else 0.0) + (back if cluster.results_to_store else 0.0)
    by_way = 0.0 if cluster.results_to_store else back
    reading, writing = (_stored(*some, cluster) for some in ((read, GETS), (write, PUTS)))
    of_batch = costs.scheduler_batch + costs.scheduler_batch_worker * max(0, cluster.workers / many - 2)
    work = Work(
        before=[Station("scheduler", of_batch, costs.scheduler_byte * by_way, many)],
        reading=reading,
        each=task + costs.worker[name],
        writing=writing,
        after=[
            Station("links", 0.0, by_way / cluster.link, many),
            Station("client", costs.client_batch, costs.client[name], many),
        ],
    )
    alone = work.each + sum(station.each for station in (*reading, *writing))
    most = int(
        max(1, min(cluster.span / alone if alone else math.inf, BATCH_BYTES / by_way if by_way else math.inf, 1e6))
    )
    used = busy(bake.chunks, cluster.workers, most, work.stations)
    used["workers"] = bake.chunks * task / cluster.workers
    every = bake.chunks * work.each + sum(many * used[which] for which in ("scheduler", "client"))
    return max(makespan(bake.chunks, cluster.workers, work, most), every / cluster.shared_cores), used


def _stored(size: float, requests: float, cluster: Cluster) -> list[Station]:
    if not size:
        return []
    if cluster.object_store:
        # Each thread waits for its own requests, and all for the store's.
        one = Station("one request", 0.0, size / ONE_REQUEST, cluster.workers)
        return [Station("store", 0.0, 1 / requests), one]
    return [Station("store", 0.0, size / cluster.store)]


def simulate(bake: Bake, cluster: Cluster, costs: Costs) -> Outcome:
    """A whole bake."""
    found, count = Outcome(), bake.receivers * cluster.scene_share
    alone = bake.receivers * costs.client_alone / cluster.client_cores

    def send(part: str, size: float, arrival: float) -> None:
        seconds = broadcast(size * count, cluster, costs.hop)
        found.add(part, seconds + arrival * count, {"links": seconds, "tree": arrival * count})

    found.add("client", alone, {"client": alone})
    send("scene", costs.scene, costs.arrival)
    found.add("trace", *stage("trace and keep" if bake.bounces else "trace", bake, cluster, costs))
    bounce = stage("bounce", bake, cluster, costs) if bake.bounces else (0.0, {})
    for _ in range(bake.bounces):
        send("exit radiance", costs.exitant, costs.exit_arrival)
        found.add("bounces", *bounce)
    if bake.bounces > 1:
        # The estimate of the error gathers once from the sum of what all but the last bounce sent.
        send("exit radiance", costs.exitant, costs.exit_arrival)
    found.held = costs.held * count
    found.machine_held = found.held * max(1, cluster.cores // cluster.threads)
    found.busy.pop("one request", None)
    return found


# What would move the walls, by name, in the order in which it is tried.
REMEDIES: dict[str, dict[str, Any]] = {
    "one process of 8 threads a machine": {"threads": CORES},
    "client's own work on 8 cores": {"client_cores": CORES},
    "ten file servers": {"store": 10 * LINK},
}
# Others, which change what is computed or what it runs on.
FURTHER: dict[str, dict[str, Any]] = {
    "hits in an object store": {"object_store": True},
    "batches of 5 s": {"span": 5.0},
    "results to the store": {"results_to_store": True},
    "two schedulers, two clients": {"schedulers": 2},
    "links of 100 Gbit/s": {"link": 10 * LINK},
    "a tenth of the scene a worker": {"scene_share": 0.1},
}
TOGETHER = {name: value for each in REMEDIES.values() for name, value in each.items()}
