"""How far is the exit radiance of glossy transfer from the integral? By material, order, light, and frame.

    python scripts/benchmarks/glossy.py

150 receivers of the bunny (TORCHPRT_DATA names the folder with mesh/bunny.ply and hdri/*.exr) or, without it, of the
project's own sculpture, each seen from 150 directions that are uniform on its hemisphere. The reference is the
integral over the hemisphere in float64 with 32768 rays, without any basis but that of the light. Errors are RMS
relative to the RMS of the reference.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import torch
from rich.console import Console
from torch import Tensor

from torchprt import brdf, light, sh
from torchprt.measure import (
    Table,
    compare_frames,
    exit_radiance,
    exit_radiance_by_brute_force,
    random_lights,
    relative_rms,
    sample_receivers,
    sample_transfer,
)
from torchprt.scene import Material, Mesh, Scene, TangentWarning, load, read_mesh, samples
from torchprt.sh import Projection
from torchprt.shade import shader, with_material
from torchprt.transfer import Dense, Transfer
from torchprt.transport import OrderWarning, bake, hemisphere

ORDER, HIGHEST, RECEIVERS, VIEWS = 5, 10, 150, 150
MATERIALS = (
    *("phong:10", "phong:20", "phong:40", "phong:80", "blinn:40", "blinn:160"),
    *("ggx:0.5", "ggx:0.3", "ggx:0.3,0.04", "ggx:0.2", "ggx:0.1", "ward:0.1,0.4"),
)
CHOSEN = ("phong:10", "phong:20", "ggx:0.5", "ggx:0.3")
# The mean of two bakes stands for twice the rays.
MANY_RAYS, SEEDS = 4096, (0, 1)


def folder() -> Path:
    return Path(os.environ.get("TORCHPRT_DATA") or Path(__file__).parents[3] / "shared" / "data")


def mesh_to_measure(console: Console) -> Mesh:
    """The bunny where there is one, else the sculpture; says which."""
    path = folder() / "mesh" / "bunny.ply"
    if path.is_file():
        console.print(f"scene: {path.name}")
        return read_mesh(path)
    console.print(f"scene: the project's own sculpture, since there is no {path} (set TORCHPRT_DATA)")
    return samples.organic(35_000).objects[0].mesh


class Measured:
    """One material on a few receivers: baked once at the highest output order, of which lower ones are a part."""

    def __init__(self, mesh: Mesh, material: str):
        scene = load(mesh, material=Material(0.0, gloss=material))
        self.scene, self.chosen = sample_receivers(scene, RECEIVERS)
        self.views = hemisphere(VIEWS, seed=3)

    def reference(self, lights: Tensor) -> Tensor:
        return exit_radiance_by_brute_force(self.scene, self.chosen, self.views, lights, seed=1)

    def bake(self, rays: int, projection: Projection = "optimal", seeds: tuple[int, ...] = (0,)) -> Transfer:
        options = {"order": ORDER, "output_order": HIGHEST, "projection": projection, "progress": False}
        found = [bake(self.scene, rays=rays, seed=seed, **options) for seed in seeds]
        matrix = sum(each.layers["exit"].signal.values for each in found) / len(found)
        return found[0].with_layers(exit=found[0].layers["exit"].replace(signal=Dense(values=matrix)))

    def radiance(self, transfer: Transfer, lights: Tensor, order: int | None = None) -> Tensor:
        """Of the first exit functions, those of `order`, if it is given."""
        if order is not None:
            layer = transfer.layers["exit"]
            matrix = Dense(values=layer.signal.values[:, :, : order * order])
            transfer = transfer.with_layers(exit=layer.replace(signal=matrix, output_order=order))
        module = shader(sample_transfer(transfer, self.chosen), dtype=torch.float64)
        return exit_radiance(module, self.views, lights)


def real_lights() -> dict[str, Tensor]:
    """Photographed environments where there are any, and a directional light."""
    found = {}
    for path in sorted((folder() / "hdri").glob("*.exr")):
        image, _ = light.read_with_report(path)
        found[path.stem] = light.project(image, ORDER).double()
    found["directional"] = light.directional((0.3, 0.8, 0.5), order=ORDER).double().expand(-1, 3)
    return found


def orders_and_lights(mesh: Mesh) -> tuple[Table, Table, Table, Table]:
    smooth = random_lights(8, ORDER)
    groups = {"random": smooth, "white": white_lights()}
    real = real_lights()
    groups |= {name: each[None] for name, each in real.items()}
    groups |= {f"{name}, windowed": sh.least_window(each)[0][None] for name, each in real.items()}
    everything = torch.cat(list(groups.values()))
    places = torch.arange(len(everything)).split([len(each) for each in groups.values()])
    optimal = Table(f"optimal projection: error by output order, {MANY_RAYS} rays twice; and with 1024 rays")
    zero = Table("projection zero: error by output order, 1024 rays")
    figure = Table(
        "figure 7 of Sloan, Hall, Hart and Snyder 2003, 1024 rays: both sides projected as there; then one, as here"
    )
    lights = Table("optimal projection, 1024 rays: error by light and output order")
    for name in MATERIALS:
        measured = Measured(mesh, name)
        exact = measured.reference(everything)
        wanted = exact[places[0]]
        few, padded = measured.bake(1024), measured.bake(1024, "zero")
        many = measured.bake(MANY_RAYS, seeds=SEEDS)
        incident = bake(measured.scene, order=ORDER, frame="incident", progress=False)

        def error(transfer: Transfer, order: int | None = None) -> str:
            return percent(relative_rms(measured.radiance(transfer, smooth, order), wanted))  # noqa: B023

        columns = {str(order): error(many, order) for order in range(3, HIGHEST + 1)}
        optimal.add(name, extra=columns | {f"{order}, 1024 rays": error(few, order) for order in (5, 8)})
        zero.add(name, extra={str(order): error(padded, order) for order in range(3, HIGHEST + 1)})
        model = brdf.parse(name)
        both = {
            "zero, 16x25": with_material(incident, model, 4, "zero"),
            "optimal, 16x25": with_material(incident, model, 4),
            "zero, 25x25": with_material(incident, model, 5, "zero"),
            "optimal, 25x25": with_material(incident, model, 5),
        }
        one = {"zero, 25": error(padded, 5), "optimal, 16": error(few, 4), "optimal, 25": error(few, 5)}
        figure.add(name, extra={key: error(each) for key, each in both.items()} | one)
        if name in CHOSEN:
            for order in (5, 8):
                found = measured.radiance(few, everything, order)
                pairs = zip(groups, places, strict=True)
                errors = {each: percent(relative_rms(found[rows], exact[rows])) for each, rows in pairs}
                windowed = {each: errors.pop(f"{each}, windowed") for each in real}
                told = {"exit_error": percent(brdf.exit_error(model, order, ORDER))}
                lights.add(f"{name}, order {order}", extra=errors | told)
                lights.add(f"{name}, order {order}, windowed", extra=windowed)
    return optimal, zero, figure, lights


def product_errors(mesh: Mesh) -> Table:
    table = Table("frame visibility: difference to the matrices of the same 1024 rays")
    lights = torch.cat([random_lights(8, ORDER), white_lights()])
    for name in ("phong:20", "ggx:0.3"):
        measured = Measured(mesh, name)
        options = {"order": ORDER, "progress": False}
        wanted = measured.radiance(bake(measured.scene, **options), lights)
        for order in (3, 5, 8, 10):
            transfer = bake(measured.scene, frame="visibility", visibility_order=order, **options)
            found = measured.radiance(transfer, lights)
            measured_errors = {
                "measured, white": percent(relative_rms(found[8:], wanted[8:])),
                "measured, random": percent(relative_rms(found[:8], wanted[:8])),
            }
            stated = percent(transfer.layers["visibility"].product_error)
            table.add(f"{name}, {order}", extra={"product_error": stated, **measured_errors})
    return table


def white_lights() -> Tensor:
    """Coefficients all independent, of one variance: negative in places."""
    white = torch.randn(8, ORDER**2, 1, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return white.expand(-1, -1, 3)


def factor_errors() -> Table:
    """Cook-Torrance in products of a view and a light function."""
    counts = (1, 2, 3, 4, 6, 8, 10, 12, 16)
    table = Table("factored: error of unshadowed exit radiance under white light of order 4, by rows")
    for name in ("ggx:0.5", "ggx:0.4", "ggx:0.3", "ggx:0.2", "ggx:0.1"):
        errors = brdf.factor(brdf.parse(name), rows=1, light_order=4).errors
        table.add(name, extra={str(count): percent(errors[count - 1]) for count in counts})
    return table


def exit_errors() -> Table:
    table = Table(f"exit_error by output order: unshadowed, white light of order {ORDER}")
    for name in MATERIALS:
        model = brdf.parse(name)
        errors = {str(n): percent(brdf.exit_error(model, n, ORDER)) for n in range(3, HIGHEST + 1)}
        table.add(name, extra=errors)
    return table


def percent(value: float) -> str:
    return f"{100 * value:.2f} %"


def run() -> None:
    """Prints every table."""
    torch.set_num_threads(1)
    # Errors of too low an order are what is asked for.
    warnings.simplefilter("ignore", OrderWarning)
    warnings.simplefilter("ignore", TangentWarning)
    console = Console(width=160)
    mesh = mesh_to_measure(console)
    for table in (*orders_and_lights(mesh), exit_errors(), product_errors(mesh), factor_errors()):
        console.print(table)
    for name in ("phong:20", "ggx:0.3"):
        scene: Scene = load(mesh, material=Material(0.0, gloss=name))
        console.print(compare_frames(scene, factors=(3, 6, 12)))


if __name__ == "__main__":
    run()
