"""How much memory does a bake need? Peak of the resident set as vertices and rays grow, up to a million vertices.

    python scripts/benchmarks/memory.py

Each bake runs in a process of its own. "formula" adds up what the docstring of `torchprt.transport.bake` counts
(scene, tree, result, threads), with Embree's tree as measured; "grown" is what the bake added at its peak to what was
there "before": the interpreter, torch and the mesh. Between them stand what torch loads when first used (some 30 MiB)
and copies that live for a moment.
"""

import functools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import rich
import torch
from rich.console import Console

from torchprt.measure import Table
from torchprt.scene import Mesh, load, make_mesh
from torchprt.trace import Tracer
from torchprt.transport import bake
from torchprt.transport.task import CHUNK

ORDER, LIMIT = 5, 8 * 2**30
SIZES, RAYS = (8_000, 50_000, 200_000), (64, 1024)
MILLION = 1_000_000


def resident(peak: bool = False) -> int:
    """Bytes of this process in memory, now or at most so far."""
    name = "VmHWM:" if peak else "VmRSS:"
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return 1024 * int(line.split()[1])
    raise RuntimeError("this benchmark needs /proc, which Linux has")


class Peaks:
    """A report of progress that notes the peak at the end of each stage."""

    def __init__(self) -> None:
        self.stages: dict[str, int] = {}
        self._stage = "preparation"

    def start(self, stage: str, total: int, done: int = 0) -> None:
        self.end()
        self._stage = stage

    def advance(self, count: int) -> None: ...

    def end(self) -> None:
        self.stages[self._stage] = resident(peak=True)


def rolling_ground(vertices: int) -> Mesh:
    """A square of about `vertices` vertices, displaced by waves of several sizes that shadow one another."""
    side = round(vertices**0.5)
    ticks = torch.linspace(-1, 1, side, dtype=torch.float64)
    x, z = torch.meshgrid(ticks, ticks, indexing="ij")
    height = sum(0.2 / f * torch.sin(5 * f * x + f) * torch.cos(4 * f * z - f) for f in (1, 2, 4, 8, 16))
    corner = (torch.arange(side - 1)[:, None] * side + torch.arange(side - 1)).flatten()
    faces = torch.stack([corner, corner + 1, corner + side, corner + 1, corner + side + 1, corner + side], -1)
    return make_mesh(torch.stack([x, height, z], -1).view(-1, 3), faces.view(-1, 3), name="rolling ground")


def measure_tree(vertices: int) -> dict[str, Any]:
    """What Embree's tree and its copy of the vertices take, in this process."""
    geometry = load(rolling_ground(vertices)).geometry()
    before = resident()
    tracer = Tracer(geometry.positions, geometry.faces)
    tree = resident() - before
    del tracer
    return {"tree": tree}


def measure_bake(vertices: int, rays: int, bounces: int) -> dict[str, Any]:
    """One bake in this process."""
    scene = load(rolling_ground(vertices))
    before = resident()
    # What making the mesh took is not the bake's: from here on the peak counts anew.
    Path("/proc/self/clear_refs").write_text("5")
    peaks = Peaks()
    transfer = bake(scene, order=ORDER, rays=rays, bounces=bounces, progress=peaks)
    peaks.end()
    peak = resident(peak=True)
    tensors = [value for value in vars(scene.geometry()).values() if isinstance(value, torch.Tensor)]
    v, n = transfer.vertices, ORDER**2
    each = 72 * max(1 << 16, 8 * rays) + CHUNK * (8 * n + 36) + (24 * CHUNK * rays if bounces else 0)
    return {
        "vertices": v,
        "before": before,
        "peak": peak,
        "scene": sum(tensor.numel() * tensor.element_size() for tensor in tensors),
        "result": 4 * v * n * (4 if bounces else 1),
        "threads": each * (os.cpu_count() or 1),
        "copies": 550 * v + 224 * n * rays,
        "stages": peaks.stages,
    }


@functools.cache
def in_a_process(*arguments: int) -> dict[str, Any]:
    """`measure_tree(vertices)` or `measure_bake(vertices, rays, bounces)` in a process of its own."""
    with tempfile.TemporaryFile("w+") as output:
        subprocess.run([sys.executable, __file__, *map(str, arguments)], stdout=output, check=True)
        output.seek(0)
        return json.load(output)


def run() -> None:
    """Prints one table of growth and the stages of a bake of a million vertices; says whether it stays below 8 GiB."""
    table = Table(f"peak of the resident set in MiB, order {ORDER}")
    cases = [(vertices, rays, 0) for vertices in SIZES for rays in RAYS]
    cases += [(SIZES[1], RAYS[0], 2), (MILLION, RAYS[0], 0)]
    for vertices, rays, bounces in cases:
        found = in_a_process(vertices, rays, bounces) | in_a_process(vertices)
        parts = {name: found[name] for name in ("before", "scene", "tree", "result", "threads", "copies")}
        parts["formula"] = sum(parts.values()) - parts["before"]
        parts |= {"grown": found["peak"] - found["before"], "peak": found["peak"]}
        name = f"{vertices // 1000}k x {rays} rays" + (f", {bounces} bounces" if bounces else "")
        table.add(name, extra={name: round(size / 2**20) for name, size in parts.items()})
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    for stage, peak in found["stages"].items():
        rich.print(f"a million vertices: {peak / 2**20:.0f} MiB at most until the end of '{stage}'")
    verdict = "below" if found["peak"] < LIMIT else "NOT below"
    rich.print(f"a million vertices need {found['peak'] / 2**30:.2f} GiB, {verdict} 8 GiB")


if __name__ == "__main__":
    torch.set_num_threads(1)
    if len(sys.argv) == 2:
        print(json.dumps(measure_tree(int(sys.argv[1]))))
    elif len(sys.argv) > 2:
        print(json.dumps(measure_bake(*map(int, sys.argv[1:]))))
    else:
        run()
