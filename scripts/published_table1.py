"""Table 1 of the 2002 paper, theirs beside ours: model, transfer, sampling, bake time and render rate.

    python scripts/published_table1.py [--rays 4096] [MODEL ...]

The paper's models are not available; others stand in for them. Theirs: a PC of 2002 (2.2 GHz Pentium 4, the bake), an
ATI Radeon 8500 (the rates), 10 000 to 30 000 directions over the sphere, light that bounces until its energy is below
a threshold. Ours: process CPU time of the bake, all its threads added up, with --rays directions over the hemisphere
and bounces until one adds less than 1 %; the rates are calls a second of one thread, without drawing. Glossy rows
have three rates, as in the paper: everything free, the light fixed, the eye fixed. Of the neighbourhood: the matrices
of all nodes under a new light, and with a new pose and 10 000 receivers that read them. Of the volume: its cells under
a new light; most of its 32 768 cells are empty, and are no receivers.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import torch
from rich.console import Console

from torchprt import light
from torchprt.measure import Table, time_it
from torchprt.scene import Material, Object, Scene, Volume, read_mesh, samples
from torchprt.shade import NeighbourhoodShader, shader
from torchprt.transfer import Transfer
from torchprt.transport import GridWarning, OrderWarning, bake, bake_neighbourhood, bake_volume

ORDER = 5
GLOSS = Material(0.2, gloss="phong:10", specular=0.5)
ROUNDS = 5


def bird() -> Scene:
    """A scan where there is one."""
    path = Path(os.environ.get("TORCHPRT_DATA") or Path(__file__).parents[2] / "shared" / "data") / "mesh" / "bunny.ply"
    return Scene([Object(read_mesh(path))]) if path.is_file() else samples.organic(50_000)


def glossy(scene: Scene) -> Scene:
    return Scene([Object(each.mesh, GLOSS) for each in scene.objects])


# Theirs: transfer, sampling, bake, rate; ours: a scene.
MODELS: dict[str, tuple[str, str, str, str, Callable[[], Scene | Volume]]] = {
    "head (fig 1)": ("DS 25", "50k ver.", "1.1 h", "129", lambda: samples.head(50_000)),
    "bird (fig 4)": ("DS 25", "50k ver.", "1.2 h", "125", bird),
    "ring (fig 9)": ("DS 25", "256x256 grid", "8 m", "94", lambda: samples.ring_on_plane(256)),
    "buddha_d (fig 11)": ("DS 25", "50k ver.", "2.5 h", "125", lambda: samples.organic(50_000)),
    "buddha_g (fig 11)": ("GS 25x25", "50k ver.", "2.5 h", "3.6/16/125", lambda: glossy(samples.organic(50_000))),
    "tyra_d (fig 11)": ("DS 25", "100k ver.", "2.4 h", "83", lambda: samples.organic(100_000)),
    "tyra_g (fig 11)": ("GS 25x25", "100k ver.", "2.4 h", "2.2/9.4/83", lambda: glossy(samples.organic(100_000))),
    "teapot (fig 5)": ("GS 25x25", "150k ver.", "4.4 h", "1.7/7.7/49", lambda: samples.teapot(150_000, GLOSS)),
    "glider (fig 7)": ("N 9x25", "64x64x8 vol.", "3 h", "4/120/4", samples.glider),
    "cloud (fig 6)": ("DV 25", "32x32x32 vol.", "15 m", "40", lambda: samples.cloud(32)),
}


def rates(transfer: Transfer) -> str:
    """Calls a second: of a diffuse shader one, of a glossy one three."""
    module = shader(transfer)
    lamp = light.project(light.studio(64), ORDER).float()
    if "eye" not in module.needs:
        return hertz({"one": lambda: module(lamp)})
    eye = transfer.positions.amax(0).float() * 3
    seen, lit = module.fix_eye(eye=eye), module.fix_light(lamp)
    return hertz({"free": lambda: module(lamp, eye=eye), "light": lambda: lit(eye=eye), "eye": lambda: seen(lamp)})


def neighbourhood_rates(transfer: Transfer) -> str:
    """Over as many receivers as the paper's terrain is drawn with, about: 10 000."""
    module = NeighbourhoodShader(transfer)
    lamp = light.project(light.studio(64), ORDER).float()
    land = samples.terrain(100).objects[0].mesh
    places, normals = land.positions.float(), land.normals.float()
    turned = torch.eye(4)
    turned[:3, 3] = torch.tensor([0.3, 0.9, -0.2])
    nodes = hertz({"nodes": lambda: module.signal.under(lamp)})
    return f"{nodes} nodes, {hertz({'all': lambda: module(lamp, positions=places, normals=normals, pose=turned)})} all"


def hertz(calls: dict[str, Callable[[], torch.Tensor]]) -> str:
    with torch.no_grad():
        return "/".join(f"{1 / each.median:.0f}" for each in time_it(calls, rounds=ROUNDS).values())


def row(table: Table, name: str, rays: int) -> None:
    kind, sampling, seconds, rate, scene = MODELS[name]
    made = scene()
    start = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", (OrderWarning))
        warnings.simplefilter("ignore", GridWarning)
        if isinstance(made, Volume):
            found = bake_volume(made, order=ORDER, rays=rays, progress=False)
        elif kind.startswith("N"):
            found = bake_neighbourhood(
                made, order=ORDER, output_order=3, grid=(64, 8, 64), rays=2 * rays, bounces=1, progress=False
            )
        else:
            found = bake(made, order=ORDER, rays=rays, bounces="auto", progress=False)
    spent = time.process_time() - start
    torch.set_num_threads(1)
    ours = neighbourhood_rates(found) if kind.startswith("N") else rates(found)
    extra: dict[str, float | int | str] = {
        "transfer": kind,
        "sampling": sampling,
        "bake": seconds,
        "Hz": rate,
        "our sampling": f"{found.vertices}",
        "our bake, CPU": f"{spent:.0f} s",
        "bounces": found.bounces,
        "our Hz": ours,
    }
    table.add(name, extra=extra)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="*", metavar="MODEL", help="beginnings of names; all if omitted")
    parser.add_argument("--rays", type=int, default=4096)
    given = parser.parse_args()
    chosen = [name for name in MODELS if not given.models or any(name.startswith(each) for each in given.models)]
    if not chosen:
        parser.error(f"no model is called {given.models[0]}: use {', '.join(MODELS)}")
    console = Console(width=170)
    table = Table(f"table 1 of the 2002 paper; ours with {given.rays} rays over the hemisphere, one thread's rates")
    for name in chosen:
        console.print(f"{name} ...")
        row(table, name, given.rays)
    console.print(table)


if __name__ == "__main__":
    main()
