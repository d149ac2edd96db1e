"""The figures of docs/guide.md: what rays, order, bounces, half precision and gloss cost on the project's own samples.

    python docs/make/figures.py

Error is RMS relative to the RMS of the reference; time is CPU time, which adds up the threads.
"""

from __future__ import annotations

import math
import time

import torch
from rich.console import Console
from torch import Tensor

from torchprt import light
from torchprt.brdf import exit_error, parse
from torchprt.measure import Table, compare_frames, radiance_error, relative_rms
from torchprt.scene import Material, Points, Scene, samples
from torchprt.shade import shader
from torchprt.transfer import Transfer
from torchprt.transport import bake
from torchprt.transport.bounces import Bounces

VERTICES, SAMPLE, REFERENCE_RAYS = 10_000, 400, 1 << 16


def at_points(scene: Scene, rows: Tensor, order: int, rays: int, seed: int = 0) -> Transfer:
    """Shadowed transfer at some of the vertices, so that a reference costs seconds."""
    geometry = scene.geometry()
    points = Points(geometry.receiver_positions[rows], geometry.receiver_normals[rows], 0.5)
    return bake(scene, order=order, rays=rays, receivers=points, seed=seed, progress=False)


def rays(scene: Scene, rows: Tensor, lamps: Tensor) -> Table:
    """Error of order-5 transfer by the number of rays, and what the bake itself says of it."""
    reference = at_points(scene, rows, 5, REFERENCE_RAYS, seed=7)
    wanted = shader(reference)(lamps)
    table = Table(f"rays: sculpture of {VERTICES} vertices, order 5, against {REFERENCE_RAYS} rays")
    for count in (64, 256, 1024, 4096):
        start = time.process_time()
        whole = bake(scene, order=5, rays=count, progress=False)
        seconds = time.process_time() - start
        few = at_points(scene, rows, 5, count)
        assert whole.error is not None
        assert whole.signal is not None
        vectors = (each.layers["diffuse"].signal.dense().values for each in (few, reference))
        extra = {
            "estimate": f"{whole.error / whole.signal:.2%}",
            "measured": f"{relative_rms(*vectors):.2%}",
            "radiance": f"{relative_rms(shader(few)(lamps), wanted):.2%}",
            "CPU s": f"{seconds:.1f}",
        }
        table.add(str(count), extra=extra)
    return table


def orders(scene: Scene, rows: Tensor) -> Table:
    """Error of the picture by the order, for a broad and a small lamp."""
    highest = 16
    reference = at_points(scene, rows, highest, 1 << 13)
    lamps = {
        "studio": light.project(light.studio(256), highest).float(),
        "disc of 30 degrees": light.disc((0.5, 1.0, 0.4), math.radians(30), 1.0, highest).float(),
        "disc of 5 degrees": light.disc((0.5, 1.0, 0.4), math.radians(5), 1.0, highest).float(),
    }
    table = Table(f"order: relative RMS error of radiance against order {highest}")
    for order in (2, 3, 4, 5, 6, 8):
        lower = reference.to_order(order)
        errors = {name: f"{radiance_error(lower, reference, each).relative_rms:.1%}" for name, each in lamps.items()}
        table.add(str(order), extra={**errors, "bytes a vertex": 4 * order**2})
    return table


def bounces() -> Table:
    """Radiance that is still missing after each bounce, in a bright box and on the sculpture."""
    lamps = (light.disc((0.25, 0.5, 1.0), math.radians(25), 1.6, 5) + light.constant(0.1, 5)).float()
    table = Table("bounces: relative RMS error of radiance against following light until it is spent")
    scenes = {"coloured box": samples.coloured_box(24), "sculpture, albedo .6": samples.organic(VERTICES, albedo=0.6)}
    counts: tuple[Bounces, ...] = (0, 1, 2, 3, 5, "auto")
    columns: dict[Bounces, dict[str, str]] = {count: {} for count in counts}
    for name, scene in scenes.items():
        whole = shader(bake(scene, rays=512, bounces=math.inf, progress=False))(lamps)
        for count in counts:
            baked = bake(scene, rays=512, bounces=count, progress=False)
            left = f"{relative_rms(shader(baked)(lamps), whole):.1%}"
            columns[count][name] = f"{left}, {baked.bounces}" if count == "auto" else left
    for count in counts:
        table.add(str(count), extra=columns[count])
    return table


def halves(scene: Scene, rows: Tensor, lamps: Tensor) -> Table:
    reference = at_points(scene, rows, 5, 1024)
    table = Table("storage: relative RMS error of radiance against float32")
    for dtype in (torch.float16, torch.bfloat16):
        error = radiance_error(reference.to(dtype), reference, lamps)
        table.add(str(dtype).removeprefix("torch."), extra={"error": f"{error.relative_rms:.1e}"})
    return table


def frames() -> Table:
    """What each way to store gloss costs, and loses, on one teapot."""
    teapot = samples.teapot(VERTICES, "ggx:0.3")
    return compare_frames(teapot, output_orders=(5, 4), factors=(4, 8), visibility_orders=(5, 10))


def output_orders() -> Table:
    """What exit functions of an order lose of a material: `brdf.exit_error`, no shadows, white light of order 5."""
    table = Table("exit functions: relative RMS error of unshadowed exit radiance, light of order 5")
    for material in ("phong:10", "phong:40", "blinn:40", "ggx:0.5", "ggx:0.3", "ggx:0.1", "ward:0.1,0.4"):
        errors = {str(order): exit_error(parse(material), order, 5) for order in (3, 4, 5, 6, 8)}
        table.add(material, extra={order: f"{error:.1%}" for order, error in errors.items()})
    return table


def glossy_bounces() -> Table:
    """Radiance of a glossy teapot that is still missing after each bounce, toward one eye."""
    lamps, eye = light.project(light.studio(256), 5).float(), torch.tensor([1.6, 2.0, 2.6])
    table = Table("bounces between glossy surfaces: teapot, against four bounces")
    metal, mixed = Material(gloss="ggx:0.3"), Material(0.4, gloss="ggx:0.3", specular=0.5)
    for name, material in {"ggx:0.3": metal, "albedo .4, specular .5": mixed}.items():
        teapot = samples.teapot(8000, material)
        several = [bake(teapot, rays=256, bounces=count, progress=False) for count in (0, 1, 2, 4)]
        shaded = [shader(transfer)(lamps, eye=eye) for transfer in several]
        extra = {str(count): f"{relative_rms(shaded[count], shaded[-1]):.1%}" for count in range(3)}
        table.add(name, extra=extra)
    return table


def main() -> None:
    torch.set_num_threads(1)
    console = Console(width=110)
    scene = samples.organic(VERTICES)
    vertices = len(scene.geometry().receiver_positions)
    rows = torch.randperm(vertices, generator=torch.Generator().manual_seed(0))[:SAMPLE]
    lamps = light.project(light.studio(256), 5).float()
    makers = (
        lambda: rays(scene, rows, lamps),
        lambda: orders(scene, rows),
        bounces,
        lambda: halves(scene, rows, lamps),
        output_orders,
        frames,
        glossy_bounces,
    )
    for make in makers:
        console.print(make())


if __name__ == "__main__":
    main()
