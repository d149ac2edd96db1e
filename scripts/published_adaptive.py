"""Adaptive shading beside the tables of the paper on locally adaptive products of spherical harmonics (WSCG 2013).

    python scripts/published_adaptive.py OUT [TABLE ...]

Bakes are kept in OUT (delete them to have them made anew). The paper's models and its renderer are not available: what
is compared are ratios, on the sculpture and the teapot of the samples at about 50 000 vertices, and on a scanned bunny
(TORCHPRT_DATA names a folder with mesh/bunny.ply and hdri/*.exr; without it the head of the samples and built-in lights
stand in). Times are CPU time of one thread, in turn. "Level" l of the paper is order l + 1.

full: one call of the shader. products: the same products as adaptive shading makes them, of all receivers, at the last
order alone: what is left of the ratio beside them is what leaving receivers out brings. work: multiplications of the
specular layer, relative to those of all receivers at the last order. filtered: receivers that the last order left out.
PSNR is of the picture of 640 x 480 with its background, as the paper's, and of the pixels of the model alone.
"""

from __future__ import annotations

import functools
import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from torch import Tensor

from torchprt import light, preview, sh
from torchprt.measure import Table, psnr, time_it
from torchprt.scene import Material, Mesh, Object, Scene, read_mesh, samples
from torchprt.shade import AdaptiveShader, Shader, shader
from torchprt.transfer import Transfer, load, save
from torchprt.transport import OrderWarning, bake

OUT = Path("reproduced")
ORDER, ORDERS = 11, (3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14)
MATERIAL = Material(0.4, gloss="phong:20", specular=0.6)
SIZE, SIDE = (640, 480), (0.35, 0.45, 1.0)
# Frames per second of table 2: all coefficients, adaptive; and PSNR.
TABLE2: dict[int, tuple[float, float, float]] = {
    3: (120.0, 60.0, 46.72), 4: (70.3, 56.0, 50.72), 5: (48.6, 46.1, 45.85), 6: (31.5, 37.1, 44.29),
    7: (19.8, 30.5, 42.52), 8: (13.2, 21.4, 43.27), 9: (8.4, 15.5, 42.86), 10: (5.9, 12.2, 44.22),
    11: (4.2, 9.3, 44.27), 12: (3.1, 7.6, 42.80), 13: (2.3, 5.4, 42.49), 14: (1.8, 4.1, 42.00),
}  # fmt: skip


def data() -> Path:
    named = os.environ.get("TORCHPRT_DATA")
    return Path(named) if named else Path(__file__).parents[2] / "shared" / "data"


@functools.cache
def meshes() -> dict[str, Mesh]:
    found = {name: getattr(samples, make)(50_000).objects[0].mesh for name, make in MADE.items()}
    scan = data() / "mesh" / "bunny.ply"
    return found | ({"bunny": read_mesh(scan)} if scan.is_file() else {"head": samples.head(50_000).objects[0].mesh})


MADE = {"sculpture": "organic", "teapot": "teapot"}


def lights(order: int) -> dict[str, Tensor]:
    """Three environments `[N, 3]`, with the least window that keeps them from going below zero."""
    names = {"lobby": "studio", "sunset": "sunset", "studio": "sky"}
    folder, found = data() / "hdri", {}
    for name, other in names.items():
        path = folder / f"{name}.exr"
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = light.read(path) if path.is_file() else light.built_in(other)
        found[name if path.is_file() else other] = sh.least_window(light.project(image, order).float())[0]
    return found


def baked(name: str, order: int) -> Transfer:
    """Diffuse and visibility of order `order` of a mesh, from OUT if it is there."""
    path = OUT / f"{name}_adaptive_{order}.safetensors"
    if not path.is_file():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OrderWarning)
            made = bake(
                Scene([Object(meshes()[name], MATERIAL)]),
                order=order,
                frame="visibility",
                visibility_order=order,
                rays=1024,
                progress=False,
            )
        save(made, path)
    return load(path)


class Case:
    """A bake under a light, toward one eye: shaded whole and adaptively."""

    def __init__(self, transfer: Transfer, lamp: Tensor):
        self.transfer, self.lamp = transfer, lamp
        self.camera = preview.frame(transfer.positions, SIDE, aspect=SIZE[0] / SIZE[1])
        self.still = preview.Still(transfer.positions, transfer.faces, size=SIZE, camera=self.camera)
        self.eye = torch.tensor(self.camera.eye, dtype=torch.float32)
        self.shader: Shader = shader(transfer)
        self.exposure = preview.automatic_exposure(lamp)

    def whole(self) -> Tensor:
        return self.shader(self.lamp, eye=self.eye)

    def picture(self, radiance: Tensor) -> Tensor:
        return self.still.picture(radiance, exposure=self.exposure, tone="none")

    def psnr(self, radiance: Tensor, wanted: Tensor) -> tuple[float, float]:
        """Of the whole picture, and of the pixels that the model covers."""
        found, reference = self.picture(radiance), self.picture(wanted)
        model = self.still.coverage > 0.5
        return psnr(found, reference), psnr(found[model], reference[model])

    def products(self) -> Callable[[], Tensor]:
        """The specular layer alone, all receivers at the last order; and the diffuse layer as it is."""
        layers = self.shader.layers
        levels = layers["visibility"].levels((self.shader.order,))

        def shaded() -> Tensor:
            values = layers["visibility"].values(self.eye, None)
            found = levels.at(0, self.lamp, values, None)() * layers["visibility"].weight.T
            return layers["diffuse"](self.lamp) + found

        return shaded

    def row(self, table: Table, name: str, extra: dict[str, Any] | None = None, **options: Any) -> None:
        adaptive = AdaptiveShader(self.shader, self.transfer.faces, **options)

        def ours() -> Any:
            return adaptive(self.lamp, eye=self.eye)

        times = time_it({"full": self.whole, "products": self.products(), "ours": ours}, rounds=4, seconds=0.01)
        found, regions = ours()
        whole, model = self.psnr(found, self.whole())
        full, products, took = (1e3 * times[each].best for each in ("full", "products", "ours"))
        filtered = {each: 100 * float((o < self.shader.order).float().mean()) for each, o in regions.orders.items()}
        work = adaptive.adaptive["visibility"].cost(regions.layers["visibility"])
        columns: dict[str, Any] = {
            "full, ms": f"{full:.0f}",
            "products, ms": f"{products:.0f}",
            "ours, ms": f"{took:.0f}",
            "full / ours": f"{full / took:.2f}",
            "products / ours": f"{products / took:.2f}",
            "work": f"{work:.2f}",
            "filtered: diffuse": f"{filtered['diffuse']:.0f} %" if "diffuse" in filtered else "whole",
            "specular": f"{filtered['visibility']:.0f} %",
            "PSNR, dB": f"{whole:.1f}",
            "model": f"{model:.1f}",
        }
        table.add(name, extra=columns | (extra or {}))


def table1() -> Table:
    """The paper: 2.2 to 3.4 times, diffuse 9 to 19 % filtered, specular 73 to 91 %."""
    table = Table(f"table 1, order {ORDER}, T = .02 specular, .01 diffuse unless whole. Published: 2.20 - 3.38")
    ways: dict[str, dict[str, Any]] = {
        "": {},
        ", no growth": {"grow": False},
        ", both": {"diffuse": 0.01},
    }
    for mesh in meshes():
        transfer = baked(mesh, ORDER)
        for name, lamp in lights(ORDER).items():
            case = Case(transfer, lamp)
            for way, options in ways.items():
                case.row(table, f"{mesh}, {name}{way}", **options)
    return table


def table2() -> Table:
    """The scan under the first light, by order."""
    table = Table("table 2, by order")
    for order in ORDERS:
        full, ours, published = TABLE2[order]
        case = Case(baked(list(meshes())[-1], order), next(iter(lights(order).values())))
        extra = {"published": f"{ours / full:.2f}", "its PSNR": f"{published:.1f}"}
        case.row(table, f"order {order}", extra)
        case.row(table, f"order {order}, no growth", grow=False)
    return table


def choices() -> Table:
    """What each part of the method costs and brings, on the sculpture under the first light."""
    case = Case(baked("sculpture", ORDER), next(iter(lights(ORDER).values())))
    table = Table(f"choices, order {ORDER}, the sculpture")
    ways: dict[str, dict[str, Any]] = {
        "as it is": {},
        "diffuse too": {"diffuse": 0.01},
        "differences from order 3, as the paper": {"against": "base"},
        "no growth": {"grow": False},
        "no rings": {"rings": 0},
        "hard regions": {"blend": 0},
        "every order": {"levels": range(3, ORDER + 1)},
        "orders 3, 5, 8, 11": {"levels": (3, 5, 8, 11)},
        "half the threshold": {"specular": 0.01},
        "twice the threshold": {"specular": 0.04},
    }
    for name, options in ways.items():
        case.row(table, name, **options)
    return table


def turning(frames: int = 20, degrees: float = 10.0) -> Table:
    """A light that turns by half a degree a frame: the largest change of the error from frame to frame."""
    case = Case(baked(list(meshes())[-1], ORDER), next(iter(lights(ORDER).values())))
    white = 2.0**-case.exposure
    table = Table(f"a turning light, {degrees / frames:g} degrees a frame, {frames} frames; parts of white")
    for name, options in {
        "hard regions": {"blend": 0, "hysteresis": 1},
        "hard regions, hysteresis": {"blend": 0},
        "blend": {"hysteresis": 1},
        "blend and hysteresis": {},
        "wide blend and hysteresis": {"blend": 0.5},
    }.items():
        adaptive = AdaptiveShader(case.shader, case.transfer.faces, diffuse=None, **options)
        regions, last, largest, popped, work = None, None, 0.0, 0, 0.0
        for frame in range(frames):
            turn = sh.yaw_pitch_roll(torch.tensor([degrees * frame / frames, 0.0, 0.0]))
            found, regions = adaptive(case.lamp, turn, eye=case.eye, regions=regions)
            error = (found - case.shader(case.lamp, turn, eye=case.eye)) / white
            if last is not None:
                change = (error - last).abs().amax(-1)
                largest, popped = max(largest, float(change.max())), popped + int((change > 0.02).sum())
            last = error
            work += adaptive.adaptive["visibility"].cost(regions.layers["visibility"]) / frames
        columns = {
            "largest change": f"{largest:.3f}",
            "changes above .02, a frame": f"{popped / (frames - 1):.1f}",
            "work": f"{work:.2f}",
        }
        table.add(name, extra=columns)
    return table


def diffuse() -> Table:
    """Why the diffuse layer is best shaded whole: one product that streams the transfer, and what choosing costs."""
    table = Table("the diffuse layer alone, the sculpture")
    for order in (5, 8, 11, 14):
        case = Case(baked("sculpture", order), next(iter(lights(order).values())))
        layer = case.shader.layers["diffuse"]
        alone = Shader({"diffuse": layer}, case.shader.turn, case.shader.vertices)
        adaptive = AdaptiveShader(alone, case.transfer.faces, diffuse=0.01)
        few = AdaptiveShader(alone, case.transfer.faces, diffuse=0.01, levels=(3, 4, order), rings=0)
        values = layer.signal.part(0, order).toward(None)
        some = torch.arange(0, case.shader.vertices, 5)
        times = time_it(
            {
                "whole": lambda alone=alone, case=case: alone(case.lamp),  # type: ignore[misc]
                "ours": lambda adaptive=adaptive, case=case: adaptive(case.lamp),  # type: ignore[misc]
                "few": lambda few=few, case=case: few(case.lamp),  # type: ignore[misc]
                "gather": lambda values=values, some=some: values[0].index_select(1, some),  # type: ignore[misc]
            },
            rounds=5,
        )
        megabytes = values.numel() * values.element_size() / 1e6
        whole = 1e3 * times["whole"].best
        columns = {
            "MB": f"{megabytes:.0f}",
            "whole, ms": f"{whole:.2f}",
            "GB/s": f"{megabytes / whole:.0f}",
            "adaptive, ms": f"{1e3 * times['ours'].best:.1f}",
            "two tests, no rings, ms": f"{1e3 * times['few'].best:.1f}",
            "gather of a fifth, ms": f"{1e3 * times['gather'].best:.2f}",
        }
        table.add(f"order {order}", extra=columns)
    return table


TABLES = {"table1": table1, "table2": table2, "choices": choices, "turning": turning, "diffuse": diffuse}


def run(out: str, names: list[str]) -> None:
    """Prints the tables that are named, all if none is."""
    global OUT
    unknown = [name for name in names if name not in TABLES]
    if unknown:
        sys.exit(f"error: there is no table '{unknown[0]}': name some of {', '.join(TABLES)}")
    OUT = Path(out)
    OUT.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    console = Console(width=None if sys.stdout.isatty() else 180)
    with torch.no_grad():
        for name in names or TABLES:
            console.print(TABLES[name]())


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("error: say where to keep the bakes: python scripts/published_adaptive.py OUT [TABLE ...]")
    run(sys.argv[1], sys.argv[2:])
