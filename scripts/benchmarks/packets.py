"""What packets of rays bring: whole bakes by both engines beside bare embreex and Mitsuba's LLVM variant, same rays.

    python scripts/benchmarks/packets.py

The bunny (TORCHPRT_DATA names the folder with mesh/bunny.ply) or, without it, the project's own sculpture. Order 5,
1024 rays, every core, rounds in turns. Bare embreex and Mitsuba get their rays prepared, outside of the time. Then the
rays that end elsewhere with one engine than with the other, and how near to an edge of a triangle those go.
"""

import os
import statistics
import time
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np
import rich
import torch
from bake import ORDER, RAYS, bare_tracing, scene_to_measure, timed

from torchprt.measure import Table
from torchprt.scene import Scene, load
from torchprt.trace import ENGINE, Tracer
from torchprt.trace.rays import in_the_world
from torchprt.transport import bake, hemisphere
from torchprt.transport.receivers import Receivers
from torchprt.transport.solve import vertex_receivers
from torchprt.transport.task import chunks

ROUNDS = 9
# Rays that Mitsuba gets at a time: 2^22 were as fast as more.
WAVE = 1 << 22
ENGINES = ("packets", "embreex")


def of_scene(scene: Scene, engine: str) -> tuple[Tracer, Receivers]:
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces, engine)
    return tracer, vertex_receivers(geometry, tracer)


def baked(scene: Scene, engine: str, **options: Any) -> float:
    """Wall seconds of a bake."""
    with mock.patch.dict(os.environ, {ENGINE: engine}):
        return timed(lambda: bake(scene, order=ORDER, rays=RAYS, progress=False, **options))[0]


def with_mitsuba(scene: Scene) -> Callable[[], float] | None:
    """What measures Mitsuba's `ray_test` of all rays of a bake, None without Mitsuba."""
    try:
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
    except (ImportError, RuntimeError):
        return None
    tracer, receivers = of_scene(scene, "embreex")
    positions = tracer.local(tracer._positions).float().numpy()
    mesh = mi.Mesh("scene", len(positions), len(tracer._faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = positions.ravel()
    parameters["faces"] = tracer._faces.numpy().astype(np.uint32).ravel()
    parameters.update()
    world = mi.load_dict({"type": "scene", "mesh": mesh})
    rays, frames = hemisphere(RAYS).float(), receivers.frames()

    def measure() -> float:
        spent = 0.0
        step = WAVE // RAYS
        for first in range(0, len(receivers), step):
            rows = slice(first, first + step)
            start, toward = in_the_world(receivers.origins[rows], frames[rows], rays)
            wave = mi.Ray3f(mi.Point3f(np.ascontiguousarray(start.T)), mi.Vector3f(np.ascontiguousarray(toward.T)))
            dr.eval(wave)
            dr.sync_thread()
            begun = time.perf_counter()
            dr.eval(world.ray_test(wave))
            dr.sync_thread()
            spent += time.perf_counter() - begun
        return spent

    return measure


def rates(scene: Scene) -> Table:
    threads = os.cpu_count() or 1
    _, receivers = of_scene(scene, "embreex")
    alone, _ = of_scene(scene, "embreex")
    million = len(receivers) * RAYS / 1e6
    measures: dict[str, Callable[[], float]] = {
        f"bake, {engine}": lambda e=engine: baked(scene, e) for engine in ENGINES
    }
    measures["bare embreex"] = lambda: bare_tracing(alone, receivers, threads)[0]
    if (mitsuba := with_mitsuba(scene)) is not None:
        measures["Mitsuba, ray_test"] = mitsuba
    glossy = load([each.mesh for each in scene.objects], material="ggx:0.3")
    for engine in ENGINES:
        measures[f"bake with 2 bounces, {engine}"] = lambda e=engine: baked(scene, e, bounces=2)
    for engine in ENGINES:
        measures[f"bake of matrices, {engine}"] = lambda e=engine: baked(glossy, e)
    rounds: list[dict[str, float]] = []
    for _ in range(ROUNDS + 1):
        rounds.append({name: million / measure() for name, measure in measures.items()})
    # The first compiles, and fills caches.
    del rounds[0]
    table = Table(f"{len(receivers)} receivers, {million:.1f} million rays, {threads} threads, {ROUNDS} rounds")

    def add(name: str, values: list[float], unit: str) -> None:
        low, middle, high = statistics.quantiles(values, n=4)
        table.add(name, extra={"median": middle, "quartiles": f"{low:.3g} - {high:.3g}", "unit": unit})

    for name in measures:
        add(name, [each[name] for each in rounds], "Mray/s")
    for other in ("bare embreex", "Mitsuba, ray_test"):
        if other in measures:
            add(f"bake, packets / {other}", [each["bake, packets"] / each[other] for each in rounds], "")
    for kind in ("bake", "bake with 2 bounces", "bake of matrices"):
        add(f"{kind}, packets / embreex", [each[f"{kind}, packets"] / each[f"{kind}, embreex"] for each in rounds], "")
    return table


def differences(scene: Scene) -> str:
    """Rays that one engine blocks, and the other does not."""
    (first, receivers), (second, _) = (of_scene(scene, engine) for engine in ENGINES)
    frames, rays = receivers.frames(), hemisphere(RAYS).float()
    count = 0
    for rows in chunks(len(receivers)):
        arguments = receivers.origins[rows], frames[rows], rays
        count += int((first.visibility(*arguments) != second.visibility(*arguments)).sum())
    return f"{count} of {len(receivers) * RAYS} rays are blocked with one engine and not with the other"


def run() -> None:
    torch.set_num_threads(1)
    scene = scene_to_measure()
    rich.print(rates(scene))
    rich.print(differences(scene))


if __name__ == "__main__":
    run()
