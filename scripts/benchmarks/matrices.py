"""What do transfer matrices cost to bake? The share of tracing, frames and bounces, and the memory of 25k vertices.

    python scripts/benchmarks/matrices.py

The bunny (TORCHPRT_DATA names the folder with mesh/bunny.ply) or, without it, the project's own sculpture; GGX of
roughness .3, order 5, 25 x 25, 1024 rays, every core. A bake is compared with the same rays handed straight to
embreex, as in bake.py.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import rich
import torch
from bake import RAYS, bare_tracing, scene_to_measure, timed
from memory import resident, rolling_ground

from torchprt.light import project as project_light
from torchprt.light import studio
from torchprt.measure import Table
from torchprt.scene import Material, Object, Scene, load
from torchprt.shade import shader
from torchprt.trace import ENGINE, Tracer
from torchprt.transfer import load as load_transfer
from torchprt.transfer import save
from torchprt.transport import bake
from torchprt.transport.solve import vertex_receivers

ORDER, ROUNDS, LIMIT = 5, 5, 4 * 2**30
GLOSS = "ggx:0.3"


def share_of_tracing(scene: Scene, threads: int) -> Table:
    """Rounds of a bake of matrices and of its bare rays, in turns."""
    geometry = scene.geometry()
    tracer = Tracer(geometry.positions, geometry.faces, "embreex")
    receivers = vertex_receivers(geometry, tracer)
    rounds = []
    for _ in range(ROUNDS):
        whole, _ = timed(lambda: bake(scene, order=ORDER, rays=RAYS, threads=threads, progress=False))
        rounds.append((whole, bare_tracing(tracer, receivers, threads)[0]))
    table = Table(f"{len(receivers)} matrices of 25 x 25, {RAYS} rays, {threads} threads, {ROUNDS} rounds, wall")
    values = {
        "bake": ([each[0] for each in rounds], "s"),
        "embreex alone": ([each[1] for each in rounds], "s"),
        "share of embreex": ([100 * each[1] / each[0] for each in rounds], "%"),
    }
    for name, (found, unit) in values.items():
        low, middle, high = statistics.quantiles(found, n=4)
        table.add(name, extra={"median": middle, "quartiles": f"{low:.3g} - {high:.3g}", "unit": unit})
    return table


def frames_and_bounces(scene: Scene, threads: int) -> Table:
    table = Table("what else is recorded, and bounces, median of 3")
    cases: dict[str, dict[str, Any]] = {
        "exit matrices": {},
        "incident matrices": {"frame": "incident"},
        "visibility": {"frame": "visibility"},
        "exit, 64 rows": {"output_order": 8},
        "exit, 1 bounce": {"bounces": 1},
        "exit, 2 bounces": {"bounces": 2},
    }
    times: dict[str, list[float]] = {name: [] for name in cases}
    sizes = {}
    for _ in range(3):
        for name, options in cases.items():
            start = time.perf_counter()
            transfer = bake(scene, order=ORDER, rays=RAYS, threads=threads, progress=False, **options)
            times[name].append(time.perf_counter() - start)
            sizes[name] = transfer.bytes
    first = statistics.median(times["exit matrices"])
    for name, values in times.items():
        middle = statistics.median(values)
        table.add(name, seconds=middle, bytes=sizes[name], extra={"of exit matrices": middle / first})
    return table


def life(vertices: int, bounces: int) -> dict[str, int]:
    """Peak of the resident set while matrices are baked, saved, loaded and shaded."""
    scene = Scene([Object(rolling_ground(vertices), Material(gloss=GLOSS))])
    before = resident()
    Path("/proc/self/clear_refs").write_text("5")
    peaks = {"before": before}
    transfer = bake(scene, order=ORDER, rays=RAYS, bounces=bounces, progress=False)
    peaks["bake"] = resident(peak=True)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "matrices.safetensors"
        save(transfer, path)
        peaks["save"], peaks["file"] = resident(peak=True), path.stat().st_size
        del transfer
        shade = shader(load_transfer(path))
        with torch.no_grad():
            shade(project_light(studio(64), ORDER), view=torch.tensor([0.0, 1.0, 1.0]))
        peaks["load and shade"] = resident(peak=True)
    return peaks


def run() -> None:
    os.environ[ENGINE] = "embreex"
    threads = os.cpu_count() or 1
    plain = scene_to_measure()
    scene = load([each.mesh for each in plain.objects], material=GLOSS)
    rich.print(share_of_tracing(scene, threads))
    rich.print(frames_and_bounces(scene, threads))
    for bounces in (0, 1):
        with tempfile.TemporaryFile("w+") as output:
            subprocess.run([sys.executable, __file__, "25000", str(bounces)], stdout=output, check=True)
            output.seek(0)
            found = json.load(output)
        text = ", ".join(f"{name} {size / 2**20:.0f}" for name, size in found.items())
        peak = max(size for name, size in found.items() if name != "file")
        verdict = "below" if peak < LIMIT else "NOT below"
        rich.print(f"25k vertices, {bounces} bounces, peaks so far in MiB: {text}; {verdict} 4 GiB")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    if len(sys.argv) > 1:
        print(json.dumps(life(*map(int, sys.argv[1:]))))
    else:
        run()
