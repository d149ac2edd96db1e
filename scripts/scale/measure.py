"""What a bake on a cluster costs, part by part: real bakes of two workers of this machine, and tasks that do nothing.

    python scripts/scale/measure.py [FILE]        # writes scripts/scale/measured.json; some minutes

Scheduler and workers are processes of their own. Costs are CPU seconds, so that a machine that does other things too
spoils them little; every figure is the median of the repeats with the lowest and the highest. `simulate.py` makes
clusters of them. TORCHPRT_DATA names a folder with mesh/bunny.ply; without it a sample of that size is baked.
"""

import asyncio
import contextlib
import ctypes
import datetime
import json
import os
import pickle
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import distributed
import psutil
import torch

import torchprt.transport.cluster
from torchprt.scene import Scene, load, make_mesh, samples
from torchprt.transport import Cluster, bake
from torchprt.transport.cluster import connected
from torchprt.transport.task import Task, chunks

HERE = Path(__file__).parent
ORDER, RAYS, BOUNCES, WORKERS, REPEATS = 5, 1024, 1, 2, 3
# How many workers the scheduler is given to look after, with tasks that do nothing. More would take minutes here, where
# two cores do the work of all.
LOOKED_AFTER = (2, 16, 64, 128)
# Bytes of a result, to see what a byte costs on its way.
PAYLOAD, PAYLOADS = 4_000_000, 100


def scene() -> tuple[str, Scene]:
    """The bunny with every face in four, or a sample of that size."""
    data = Path(os.environ.get("TORCHPRT_DATA", "shared/data")) / "mesh" / "bunny.ply"
    if not data.exists():
        return "sample", samples.organic(140_000, albedo=0.5)
    import trimesh

    mesh = load(data).objects[0].mesh
    points, faces = trimesh.remesh.subdivide(mesh.positions.numpy(), mesh.faces.numpy())
    return "bunny x 4", load(make_mesh(torch.from_numpy(points), torch.from_numpy(faces)), albedo=0.5)


@dataclass(frozen=True)
class Nothing(Task):
    """A task that gives `size` bytes, and takes no time."""

    size: int = 0

    def compute(self, *_: Any) -> dict[str, torch.Tensor]:
        return {"nothing": torch.zeros(self.size, dtype=torch.uint8)}


def _of_worker(dask_worker: Any) -> tuple[float, float, float]:
    """CPU seconds of a worker, of its process and of that of tasks, and how many tasks of Dask it has run."""
    tasks = sum(
        seconds
        for key, seconds in dask_worker.digests_total.items()
        if isinstance(key, tuple) and key[0] == "execute" and key[-2:] == ("thread-cpu", "seconds")
    )
    return time.process_time(), tasks, dask_worker.state.executed_count


def _held(dask_worker: Any) -> int:
    """Bytes that a worker holds in memory of its own, without those that it has freed and keeps for the next time."""
    ctypes.CDLL(None).malloc_trim(0)
    return 1024 * int(re.search(r"RssAnon:\s+(\d+)", Path("/proc/self/status").read_text())[1])  # type: ignore[index]


def _machine_seconds() -> float:
    """CPU seconds that anyone on this machine, and on that which it is part of, has had."""
    times = psutil.cpu_times()
    return sum(getattr(times, name, 0.0) for name in ("user", "nice", "system", "irq", "softirq", "steal"))


def _our_seconds() -> float:
    """CPU seconds of this process and of those that it started, once they have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@dataclass
class Clock:
    """What has been spent so far, everywhere."""

    wall: float
    client: float
    scheduler: float
    workers: float
    tasks: float
    batches: float
    machine: float

    @classmethod
    def now(cls, client: distributed.Client) -> "Clock":
        of_workers = list(client.run(_of_worker).values())
        scheduler = client.run_on_scheduler(time.process_time)
        process, tasks, batches = (sum(each) for each in zip(*of_workers, strict=True))
        return cls(time.perf_counter(), time.process_time(), scheduler, process, tasks, batches, _machine_seconds())

    def __sub__(self, other: "Clock") -> "Clock":
        return Clock(*(mine - yours for mine, yours in zip(vars(self).values(), vars(other).values(), strict=True)))


class Measuring:
    """A cluster as a runner that notes what each stage costs: what is sent and made anew first, then the tasks."""

    def __init__(self, cluster: Cluster):
        self._cluster, self._known = cluster, list[object]()
        self.stages = list[dict[str, float]]()
        self.inside = 0.0

    def map(self, tasks: Iterable[Task], *shared: object) -> Generator[tuple[Any, Any], None, None]:
        tasks, client = list(tasks), self._cluster.client
        entered = time.process_time()
        sent = sum(len(pickle.dumps(each)) for each in shared if not any(each is other for other in self._known))
        self._known = list(shared)
        before = Clock.now(client)
        futures = self._cluster.send(shared)
        wall_of_sending = time.perf_counter() - before.wall
        middle, back = Clock.now(client), 0
        made_anew(client, futures)
        made = Clock.now(client)
        for task, found in self._cluster.map(tasks, *shared):
            back += sum(each.nbytes for each in found.values())
            yield task, found
        ended = time.perf_counter()
        running = Clock.now(client) - made
        self.inside += time.process_time() - entered
        count, receivers = len(tasks), sum(task.count for task in tasks)
        self.stages.append(
            {
                "wall seconds": ended - made.wall,
                # Whoever else uses the machine: where it is much, seconds of a clock say little.
                "seconds of others": max(0.0, running.machine - running.client - running.scheduler - running.workers),
                "chunks": float(count),
                "batches": running.batches,
                "task seconds a receiver": running.tasks / receivers,
                "worker seconds a chunk": (running.workers - running.tasks) / count,
                "scheduler seconds a chunk": running.scheduler / count,
                "client seconds a chunk": running.client / count,
                "bytes sent": float(sent),
                "bytes back a receiver": back / receivers,
                "wall seconds of sending": wall_of_sending,
                "worker seconds of arrival": (made - middle).workers / len(client.nthreads()),
            }
        )


def _made(*shared: Any) -> None:
    for each in shared:
        _ = each.thing


def made_anew(client: distributed.Client, futures: list[Any]) -> None:
    """What is shared, at every worker, as its first task would have it made."""
    everywhere = [client.submit(_made, *futures, workers=[worker], pure=False) for worker in client.nthreads()]
    client.gather(everywhere)


@contextlib.contextmanager
def cluster(workers: int, *, real: bool) -> Iterator[Cluster]:
    """A scheduler and workers; those that are not real are many in one process."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        file = Path(folder) / "scheduler.json"
        options = ("--port", "0", "--scheduler-file", str(file), "--no-dashboard")
        stack.enter_context(_process("-m", "distributed.cli.dask_scheduler", *options))
        while not file.exists():
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        one = ("--nthreads", "1", "--nworkers", str(workers), "--memory-limit", "0", "--no-dashboard")
        started = ("-m", "distributed.cli.dask_worker", address, *one) if real else (__file__, address, str(workers))
        stack.enter_context(_process(*started))
        with connected(address) as found:
            found.client.wait_for_workers(workers)
            yield found


@contextlib.contextmanager
def _process(*arguments: str) -> Iterator[None]:
    process = subprocess.Popen([sys.executable, *arguments], stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait()


async def many_workers(address: str, count: int) -> None:
    """So many workers in this process, until their scheduler goes."""
    workers = [distributed.Worker(address, nthreads=1, memory_limit=0, dashboard=False) for _ in range(count)]
    await asyncio.gather(*workers)
    await asyncio.gather(*(each.finished() for each in workers))


class Holding:
    """A cluster as a runner that notes how much more memory its workers have once they have the scene."""

    def __init__(self, cluster: Cluster):
        self._cluster, self.grown = cluster, list[float]()

    def map(self, tasks: Iterable[Task], *shared: object) -> Generator[tuple[Any, Any], None, None]:
        client = self._cluster.client
        before = client.run(_held)
        made_anew(client, self._cluster.send(shared))
        self.grown += [float(each - before[worker]) for worker, each in client.run(_held).items()]
        yield from self._cluster.map(tasks, *shared)


def memory(what: Scene) -> dict[str, Any]:
    """Bytes of a worker's memory a receiver that a scene takes with its tree, in workers that have held none yet."""
    with cluster(WORKERS, real=True) as workers:
        # What a worker loads to work at all.
        bake(samples.organic(8000), order=ORDER, rays=16, runner=workers, progress=False)  # type: ignore[arg-type]
        runner = Holding(workers)
        bake(what, order=ORDER, rays=16, runner=runner, progress=False)
    return {"bytes a receiver": spread([each / what.geometry().receivers for each in runner.grown[:WORKERS]])}


def bakes(what: Scene) -> dict[str, Any]:
    """What the stages of bakes cost, with and without bounces."""
    found: dict[str, list[dict[str, float]]] = {"trace": [], "trace and keep": [], "bounce": []}
    alone: list[dict[str, float]] = []
    stored = list[dict[str, float]]()
    receivers = what.geometry().receivers
    # In memory if it can be: disks of machines that are shared are another matter.
    shm = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with cluster(WORKERS, real=True) as workers, tempfile.TemporaryDirectory(dir=shm) as folder:
        for _ in range(REPEATS):
            for bounces in (0, BOUNCES):
                place = Path(folder) / "kept"
                runner, start, cpu = Measuring(workers), time.perf_counter(), time.process_time()
                options: dict[str, Any] = {"checkpoint": place, "keep": True} if bounces else {}
                bake(what, order=ORDER, rays=RAYS, bounces=bounces, runner=runner, progress=False, **options)
                wall, cpu = time.perf_counter() - start, time.process_time() - cpu
                first, *others = runner.stages
                found["trace and keep" if bounces else "trace"].append(first)
                found["bounce"] += others[:bounces]
                # What the client does of itself: reading, looking at what sees, putting together.
                alone.append({"bounces": bounces, "wall": wall, "seconds": (cpu - runner.inside) / receivers})
                if bounces:
                    stored.append({"bytes a receiver": sum(e.stat().st_size for e in place.iterdir()) / receivers})
                    for each in place.iterdir():
                        each.unlink()
                    place.rmdir()
    of = {bounces: [each for each in alone if each["bounces"] == bounces] for bounces in (0, BOUNCES)}
    return {
        "stages": {name: spreads(each) for name, each in found.items()},
        "store": spreads(stored),
        "client seconds a receiver": spread([each["seconds"] for each in of[0]]),
        "client seconds a receiver with bounces": spread([each["seconds"] for each in of[BOUNCES]]),
        "wall seconds of the bake": spread([each["wall"] for each in of[0]]),
        "wall seconds of the bake with bounces": spread([each["wall"] for each in of[BOUNCES]]),
    }


def tasks_that_do_nothing() -> dict[str, Any]:
    """What a task costs the scheduler and the client, by how many workers there are; and what a byte of its result."""
    of_scheduler, of_client, of_byte = {}, {}, {}
    for count in LOOKED_AFTER:
        # One task at a time, as if it took long: what is looked for is what each that the scheduler knows costs.
        with cluster(count, real=False) as workers, mock.patch.object(torchprt.transport.cluster, "SPAN", 0.0):
            shared = torch.zeros(1)
            _nothing(workers, 100, 0, shared)
            tasks = max(500, 5 * count)
            costs = [_nothing(workers, tasks, 0, shared) for _ in range(REPEATS if count < 100 else 1)]
            of_scheduler[count] = spread([scheduler for scheduler, _ in costs])
            of_client[count] = spread([client for _, client in costs])
            if count == WORKERS:
                heavy = [_nothing(workers, PAYLOADS, PAYLOAD, shared) for _ in range(REPEATS)]
                for name, number, base in (("scheduler", 0, of_scheduler), ("client", 1, of_client)):
                    of_byte[name] = spread([(each[number] - base[count]["median"]) / PAYLOAD for each in heavy])
    slope, start = statistics.linear_regression(list(of_scheduler), [each["median"] for each in of_scheduler.values()])
    return {
        "scheduler seconds a task by workers": of_scheduler,
        "client seconds a task by workers": of_client,
        "client seconds a task": of_client[WORKERS],
        "scheduler seconds a task": start,
        "scheduler seconds a task a worker": max(0.0, slope),
        "seconds a byte of results": of_byte,
    }


def _nothing(workers: Cluster, tasks: int, size: int, shared: object) -> tuple[float, float]:
    """CPU seconds a task of the scheduler and of the client."""

    def spent() -> tuple[float, float]:
        return workers.client.run_on_scheduler(time.process_time), time.process_time()

    before = spent()
    for _ in workers.map([Nothing(slice(0, 1), size)] * tasks, shared):
        pass
    scheduler, client = (now - then for now, then in zip(spent(), before, strict=True))
    return scheduler / tasks, client / tasks


def spread(values: list[float]) -> dict[str, float]:
    """Median, lowest and highest."""
    return {"median": statistics.median(values), "low": min(values), "high": max(values)}


def spreads(rows: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    return {name: spread([row[name] for row in rows]) for name in rows[0]}


def main(file: Path) -> None:
    start, ours, everyone = time.perf_counter(), _our_seconds(), _machine_seconds()
    name, what = scene()
    receivers = what.geometry().receivers
    found: dict[str, Any] = {
        "scene": {"name": name, "receivers": receivers, "chunks": len(chunks(receivers)), "order": ORDER, "rays": RAYS},
        "machine": _machine(),
        "workers": WORKERS,
        "repeats": REPEATS,
    }
    found |= bakes(what)
    found["memory"] = memory(what)
    found["tasks"] = tasks_that_do_nothing()
    found["seconds that this took"] = time.perf_counter() - start
    # Where that is much, CPU seconds are more than they would be, and those of a clock say nothing.
    others = _machine_seconds() - everyone - (_our_seconds() - ours)
    found["share of others"] = max(0.0, others) / found["seconds that this took"] / (os.cpu_count() or 1)
    file.write_text(json.dumps(_rounded(found), indent=1) + "\n")


def _machine() -> dict[str, Any]:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    processor = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown")
    from torchprt.trace.engines import chosen

    return {
        "processor": processor,
        "cores": os.cpu_count(),
        "python": sys.version.split()[0],
        "distributed": distributed.__version__,
        "torch": torch.__version__,
        "engine": chosen(),
        "day": datetime.date.today().isoformat(),
    }


def _rounded(thing: Any) -> Any:
    if isinstance(thing, dict):
        return {name: _rounded(each) for name, each in thing.items()}
    return float(f"{thing:.4g}") if isinstance(thing, float) else thing


if __name__ == "__main__":
    if len(sys.argv) == 3:
        asyncio.run(many_workers(sys.argv[1], int(sys.argv[2])))
    else:
        main(Path(sys.argv[1]) if sys.argv[1:] else HERE / "measured.json")
