"""How fast is a bake? Its share of bare Embree, its stages, its bounces, and the error that its rays leave.

    python scripts/benchmarks/bake.py

The bunny (TORCHPRT_DATA names the folder with mesh/bunny.ply) or, without it, the project's own sculpture. Order 5,
1024 rays, every core. A bake is compared with the same rays handed straight to embreex, prepared outside the time.
"""

import contextlib
import importlib
import math
import os
import statistics
import threading
import time
import types
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest import mock

import rich
import torch

from torchprt.measure import Table, relative_rms
from torchprt.scene import Points, Scene, load, samples
from torchprt.sh import basis
from torchprt.trace import ENGINE, Tracer
from torchprt.trace.rays import in_the_world
from torchprt.transport import bake, frames, hemisphere
from torchprt.transport.diffuse import cosine_weights, shadowed
from torchprt.transport.receivers import Receivers
from torchprt.transport.solve import vertex_receivers
from torchprt.transport.task import chunks

ORDER, RAYS, ROUNDS = 5, 1024, 9
SAMPLE, REFERENCE_RAYS, RANDOM_SETS = 256, 1 << 16, 8


def scene_to_measure() -> Scene:
    """The bunny where there is one, else the sculpture; says which."""
    folder = Path(os.environ.get("TORCHPRT_DATA") or Path(__file__).parents[3] / "shared" / "data")
    path = folder / "mesh" / "bunny.ply"
    if path.is_file():
        rich.print(f"scene: {path.name}")
        return load(path)
    rich.print(f"scene: the project's own sculpture, since there is no {path} (set TORCHPRT_DATA)")
    return samples.organic(35_000)


class Watch:
    """Wall and CPU seconds of blocks, added up over the threads that run them."""

    def __init__(self) -> None:
        self.wall = self.cpu = 0.0
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def __call__(self) -> Iterator[None]:
        wall, cpu = time.perf_counter(), time.thread_time()
        yield
        wall, cpu = time.perf_counter() - wall, time.thread_time() - cpu
        with self._lock:
            self.wall, self.cpu = self.wall + wall, self.cpu + cpu


def bare_tracing(tracer: Tracer, receivers: Receivers, threads: int) -> tuple[float, float]:
    """Wall (a thread) and CPU seconds that embreex, the engine of the tracer, takes for the rays of a bake, in its
    blocks and threads."""
    rays = hemisphere(RAYS).to(torch.float32)
    embree, watch = tracer._embree._scene, Watch()

    def one(rows: slice) -> None:
        some = receivers[rows]
        turned = frames(some.normals).to(torch.float32)
        for block in some.blocks(RAYS):
            start, directions = in_the_world(some.origins[block], turned[block], rays)
            with watch():
                embree.run(start, directions, query="OCCLUDED")

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(one, chunks(len(receivers))))
    return watch.wall / threads, watch.cpu


def timed(task: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    task()
    return time.perf_counter() - wall, time.process_time() - cpu


def share_of_tracing(scene: Scene, threads: int) -> Table:
    """Rounds of a bake and of its bare rays, in turns."""
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces, "embreex")
    receivers = vertex_receivers(geometry, tracer)
    rays = len(receivers) * RAYS
    rounds = []
    for _ in range(ROUNDS):
        whole = timed(lambda: bake(scene, order=ORDER, rays=RAYS, threads=threads, progress=False))
        rounds.append((*whole, *bare_tracing(tracer, receivers, threads)))
    table = Table(f"{len(receivers)} receivers, {rays / 1e6:.1f} million rays, {threads} threads, {ROUNDS} rounds")

    def add(name: str, values: list[float], unit: str, scale: float = 1.0) -> None:
        low, middle, high = (scale * value for value in statistics.quantiles(values, n=4))
        table.add(name, extra={"median": middle, "quartiles": f"{low:.3g} - {high:.3g}", "unit": unit})

    for column, clock in ((0, "wall"), (1, "CPU")):
        add(f"bake, {clock}", [each[column] for each in rounds], "s")
        add(f"embreex alone, {clock}", [each[column + 2] for each in rounds], "s")
        add(f"share of embreex, {clock}", [each[column + 2] / each[column] for each in rounds], "%", 100)
    add("rays of the bake", [rays / each[0] for each in rounds], "Mray/s", 1e-6)
    add("rays of embreex alone", [rays / each[2] for each in rounds], "Mray/s", 1e-6)
    return table


class Stages:
    """CPU seconds of the parts of a bake, each without the parts inside it; the error estimate has all it calls."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._estimating = False
        self._thread = threading.local()

    def of(self, stage: str, function: Callable) -> Callable:
        """`function`, watched."""

        def watched(*arguments: object, **keywords: object) -> object:
            inside = vars(self._thread).setdefault("inside", [])
            inside.append(0.0)
            # The estimate waits here for the threads that work for it.
            self._estimating |= stage == "error estimate"
            start = time.thread_time()
            try:
                return function(*arguments, **keywords)
            finally:
                spent = time.thread_time() - start
                own = spent - inside.pop()
                self.seconds["error estimate" if self._estimating else stage] += own
                if inside:
                    inside[-1] += spent
                if stage == "error estimate":
                    self._estimating = False

        return watched


def stages(scene: Scene) -> Table:
    """Where the CPU time of a bake on one thread goes."""
    parts = Stages()
    # The package gives the name of this module to the function in it.
    top = importlib.import_module("torchprt.transport.bake")
    tasks, diffuse = (importlib.import_module(f"torchprt.transport.{name}") for name in ("diffuse_tasks", "diffuse"))
    watched: list[tuple[type | types.ModuleType, str, str]] = [
        (Scene, "geometry", "scene"),
        (Tracer, "__init__", "Embree's tree"),
        (top, "vertex_receivers", "origins of the receivers"),
        (tasks, "hemisphere", "directions and projection matrix"),
        (tasks, "projection", "directions and projection matrix"),
        (Receivers, "frames", "frames"),
        (Tracer, "visibility", "tracing"),
        (tasks, "shadowed", "projection product"),
        (diffuse, "to_world", "rotation to the world"),
        (top, "error_and_signal", "error estimate"),
        (top.result, "diffuse", "result"),
    ]
    with contextlib.ExitStack() as stack:
        for owner, name, stage in watched:
            stack.enter_context(mock.patch.object(owner, name, parts.of(stage, getattr(owner, name))))
        _, whole = timed(lambda: bake(scene, order=ORDER, rays=RAYS, threads=1, progress=False))
    parts.seconds["rest"] = whole - parts.seconds.total()
    table = Table(f"stages of a bake on one thread, CPU time of {whole:.2f} s")
    for stage, spent in parts.seconds.most_common():
        table.add(stage, seconds=spent, extra={"% of the bake": 100 * spent / whole})
    return table


def bounces(scene: Scene, threads: int) -> Table:
    table = Table("what bounces cost, median of 3")
    kinds: dict[str, int | float] = {"shadowed": 0, "2 bounces": 2, "all bounces": math.inf}
    walls: dict[str, list[float]] = {name: [] for name in kinds}
    for _ in range(3):
        for name, count in kinds.items():
            walls[name].append(
                timed(
                    lambda count=count: bake(
                        scene, order=ORDER, rays=RAYS, bounces=count, threads=threads, progress=False
                    )
                )[0]
            )
    shadow = statistics.median(walls["shadowed"])
    for name, values in walls.items():
        middle = statistics.median(values)
        table.add(name, seconds=middle, extra={"of shadowed": middle / shadow})
    return table


def errors(scene: Scene, threads: int) -> Table:
    """Error of shadowed transfer at a sample of the vertices, beside the time of a bake of all of them."""
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces)
    everything = vertex_receivers(geometry, tracer)
    rows = torch.randperm(len(everything), generator=torch.Generator().manual_seed(0))[:SAMPLE]
    receivers = everything[rows]
    points = Points(receivers.points, receivers.normals)

    def baked(rays: int, seed: int = 0) -> torch.Tensor:
        return (
            bake(scene, order=ORDER, rays=rays, seed=seed, receivers=points, threads=threads, progress=False)
            .layers["diffuse"]
            .signal.values[0]
        )

    reference = baked(REFERENCE_RAYS, seed=1)

    def random(rays: int, seed: int) -> torch.Tensor:
        generator = torch.Generator().manual_seed(seed)
        directions = torch.randn(rays, 3, generator=generator, dtype=torch.float64)
        directions[:, 2].abs_()
        directions /= directions.norm(dim=-1, keepdim=True)
        weighted = basis(directions, ORDER).mT * cosine_weights(directions)
        return shadowed(tracer, receivers, directions, weighted.to(torch.float32))

    table = Table(f"relative RMS error at {len(rows)} vertices against {REFERENCE_RAYS} rays; time of all vertices")
    for rays in (256, 1024):
        seconds = timed(lambda rays=rays: bake(scene, order=ORDER, rays=rays, threads=threads, progress=False))[0]
        table.add(f"{rays} rays", error=relative_rms(baked(rays), reference), seconds=seconds)
        squares = [relative_rms(random(rays, seed), reference) ** 2 for seed in range(RANDOM_SETS)]
        table.add(f"{rays} rays, uniform random", error=math.sqrt(statistics.mean(squares)))
    return table


def run() -> None:
    """Prints every table."""
    # What a bake adds to embreex; packets.py has what packets take away.
    os.environ[ENGINE] = "embreex"
    threads = os.cpu_count() or 1
    torch.set_num_threads(1)
    scene = scene_to_measure()
    rich.print(share_of_tracing(scene, threads))
    rich.print(stages(scene))
    rich.print(bounces(scene, threads))
    rich.print(errors(scene, threads))


if __name__ == "__main__":
    run()
