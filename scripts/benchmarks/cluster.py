"""What does a cluster cost? Two workers of Dask beside two threads, and what of it is overhead; and kills of workers.

    python scripts/benchmarks/cluster.py            # bunny x 4 (or the sample), order 5, 1024 rays, bounces 0 and 2
    python scripts/benchmarks/cluster.py kills 20   # as many bakes, a worker killed at random in each: the same bits?

"overhead": milliseconds of a worker a chunk that threads do not spend, from bakes of one ray, where nearly nothing is
traced. "sent": bytes that all tasks of a stage share, pickled, a worker. "back": bytes of results a stage.
"""

import os
import pickle
import random
import sys
import time
from pathlib import Path
from typing import Any

import rich
import torch

from torchprt.scene import Scene, load, make_mesh, samples
from torchprt.transport import Cluster, bake
from torchprt.transport.cluster import connected
from torchprt.transport.task import chunks

WORKERS, ORDER, RAYS = 2, 5, 1024


def scene() -> tuple[str, Scene]:
    """The bunny with every face in four, or a sample of that size."""
    data = Path(os.environ.get("TORCHPRT_DATA", "shared/data")) / "mesh" / "bunny.ply"
    if not data.exists():
        return "sample", samples.organic(140_000)
    import trimesh

    mesh = load(data).objects[0].mesh
    points, faces = trimesh.remesh.subdivide(mesh.positions.numpy(), mesh.faces.numpy())
    return "bunny x 4", load(make_mesh(torch.from_numpy(points), torch.from_numpy(faces)), albedo=0.5)


class Counting:
    """A cluster that counts what it sends and what comes back, a stage."""

    def __init__(self, cluster: Cluster):
        self._cluster, self.stages = cluster, list[dict[str, int]]()
        self._known: list[object] = []

    def map(self, tasks: Any, *shared: object) -> Any:
        fresh = [each for each in shared if not any(each is other for other in self._known)]
        self._known = list(shared)
        counted = {"chunks": 0, "sent": sum(len(pickle.dumps(each)) for each in fresh), "back": 0}
        self.stages.append(counted)
        for task, found in self._cluster.map(tasks, *shared):
            counted["chunks"] += 1
            counted["back"] += sum(each.nbytes for each in found.values())
            yield task, found


def seconds(what: Scene, **options: Any) -> tuple[float, torch.Tensor]:
    start = time.perf_counter()
    made = bake(what, order=ORDER, progress=False, **options)
    return time.perf_counter() - start, made.layers["diffuse"].signal.values


def run() -> None:
    name, what = scene()
    receivers = what.geometry().receivers
    count = len(chunks(receivers))
    rich.print(f"{name}, {receivers} receivers, {count} chunks, {WORKERS} workers against {WORKERS} threads")
    with connected(f"local:{WORKERS}") as cluster:
        for bounces in (0, 2):
            for rays in (RAYS, 1):
                here, wanted = seconds(what, rays=rays, bounces=bounces, threads=WORKERS)
                there, found = seconds(what, rays=rays, bounces=bounces, on=cluster)
                same = "yes" if torch.equal(wanted, found) else "NO"
                said = f"{here:.1f} s threads, {there:.1f} s cluster, ratio {there / here:.3f}, same bits: {same}"
                print(f"{bounces} bounces, {rays} rays: {said}", flush=True)
                if rays == 1:
                    overhead = 1e3 * WORKERS * (there - here) / ((1 + bounces) * count)
                    rich.print(f"bounces {bounces}: overhead {overhead:.1f} ms of a worker a chunk")
        counting = Counting(cluster)
        bake(what, order=ORDER, rays=16, bounces=2, runner=counting, progress=False)  # type: ignore[arg-type]
        for number, each in enumerate(counting.stages):
            rich.print(f"stage {number}: {each}")


class Kills:
    """A report that kills a random worker after a random number of chunks."""

    def __init__(self, cluster: Cluster, at: int):
        self._cluster, self._left = cluster, at

    def start(self, stage: str, total: int, done: int = 0) -> None: ...

    def advance(self, count: int) -> None:
        self._left -= 1
        if self._left == 0:
            os.kill(random.choice(list(self._cluster.client.run(os.getpid).values())), 9)


def kills(times: int) -> None:
    """Bakes so often with a kill in each, and compares all bits."""
    what = samples.organic(12_000)
    count = 3 * len(chunks(what.geometry().receivers))
    _, wanted = seconds(what, rays=256, bounces=2, threads=WORKERS)
    same = 0
    with connected(f"local:{WORKERS}") as cluster:
        for number in range(times):
            at = random.randint(1, count - 1)
            start = time.perf_counter()
            made = bake(what, order=ORDER, rays=256, bounces=2, on=cluster, progress=Kills(cluster, at))
            same += torch.equal(made.layers["diffuse"].signal.values, wanted)
            rich.print(f"kill {number + 1} at chunk {at} of {count}: {time.perf_counter() - start:.1f} s, same {same}")
    rich.print(f"{same} of {times} bakes have the same bits")
    sys.exit(same != times)


if __name__ == "__main__":
    if sys.argv[1:2] == ["kills"]:
        kills(int(sys.argv[2]))
    else:
        run()
