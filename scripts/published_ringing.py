"""Writes docs/ringing.md: how far lights ring by order and window, and what each window costs the shading.

    python scripts/published_ringing.py [PAGE] [--lights NAME ...] [--orders N ...]

`TORCHPRT_DATA` names a folder with hdri/*.exr; without one, and without shared/data beside the checkout, photographs
are left out.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from torchprt import light, sh
from torchprt.light.windowed import NARROWEST
from torchprt.measure import exit_radiance, exit_radiance_by_brute_force, sample_receivers, sample_transfer
from torchprt.scene import Material, Points, Scene, samples
from torchprt.shade import shader
from torchprt.trace import Tracer
from torchprt.transfer import Transfer
from torchprt.transport import OrderWarning, bake, hemisphere

ROOT = Path(__file__).parents[1]
ORDERS = (3, 4, 5, 6, 8, 10, 12, 16)
GLOSSY_ORDERS = (3, 5, 8)
HEIGHT, TEXELS, SUN_RAYS = 256, 64, 64
RECEIVERS, RAYS, GLOSSY, VIEWS = 500, 4096, 48, 16
# Of the radiance of gloss, that is: of lights without a window.
HIGH = 24
# A receiver counts as negative below so much of the mean.
SEEN = 0.01

HEAD = """# Ringing

Written by `scripts/published_ringing.py`, which `scripts/reproduce` runs; not by hand.

A light that is cut off at order n rings: it is negative around its lamps. A window takes that away and blurs. What
ought a window do, and when? Below, lights without a window and under each of `light.WINDOWS`: the curves of Hann,
Lanczos and Gauss of width n; "least", the weakest Gaussian that leaves the light itself nowhere negative
(`sh.least_window`); "auto", the weakest that leaves it nowhere negative once it is gathered in a lobe
cos^(n^2 / {narrowest}), about the narrowest part of the sky that a shadowed receiver of n bands can tell apart.

![A sun at orders 5 and 10, without a window and under auto](images/ringing_sun.png)
"""


@dataclass(frozen=True)
class Lamp:
    """A light of any order, and rays that stand for it: directions and radiance times solid angle."""

    project: Callable[[int], Tensor]
    directions: Tensor
    power: Tensor
    peak: float


def of_image(image: Tensor) -> Lamp:
    small = interpolate(image.movedim(-1, 0)[None].double(), (TEXELS, 2 * TEXELS), mode="area")[0].movedim(0, -1)
    weights = sh.latlong_weights(TEXELS, 2 * TEXELS)[..., None]
    directions = sh.latlong_directions(TEXELS, 2 * TEXELS).reshape(-1, 3)
    power = (small * weights).reshape(-1, 3)
    return Lamp(lambda order: light.project(image.double(), order), directions, power, float(small.max()))


def sun_and_sky() -> Lamp:
    """A sun of its true size, which no image of this size holds."""
    toward = torch.nn.functional.normalize(torch.tensor([0.5, 0.7, 0.4], dtype=torch.float64), dim=-1)
    elevation = math.pi / 2 - torch.acos(toward[1])
    directions = sh.latlong_directions(TEXELS, 2 * TEXELS).reshape(-1, 3)
    sky = light.clear_sky_radiance(directions, toward, 3.0)
    weights = sh.latlong_weights(TEXELS, 2 * TEXELS).reshape(-1, 1)
    beam = light.sun_radiance(math.pi / 2 - elevation, 3.0)
    # Equal areas of the disc, in a spiral.
    turn = torch.arange(SUN_RAYS).double()
    radius, angle = ((turn + 0.5) / SUN_RAYS).sqrt() * math.radians(0.2665), turn * 2.399963
    across = torch.nn.functional.normalize(torch.linalg.cross(toward, torch.eye(3).double()[0]), dim=-1)
    other = torch.linalg.cross(toward, across)
    disc = toward + radius[:, None] * (angle.cos()[:, None] * across + angle.sin()[:, None] * other)
    disc = torch.nn.functional.normalize(disc, dim=-1)
    solid = 2 * math.pi * (1 - math.cos(math.radians(0.2665))) / SUN_RAYS
    ground = (sky * weights * directions[:, 1:2].clamp(min=0)).sum(0) + solid * beam * disc[:, 1:2].sum()
    radiance = torch.where(directions[:, 1:2] > 0, sky, 0.2 / math.pi * ground)
    return Lamp(
        lambda order: light.clear_sky(toward, 3.0, order),
        torch.cat([directions, disc]),
        torch.cat([radiance * weights, solid * beam.expand(SUN_RAYS, 3)]),
        float(beam.max()),
    )


def of_disc(degrees: float) -> Lamp:
    toward = torch.nn.functional.normalize(torch.tensor([0.35, 1.0, 0.2], dtype=torch.float64), dim=-1)
    directions = sh.latlong_directions(4 * TEXELS, 8 * TEXELS)
    inside = (directions @ toward > math.cos(math.radians(degrees)))[..., None]
    made = of_image(torch.where(inside, 100.0, 0.1).expand(-1, -1, 3))
    return made


def photographs() -> dict[str, Lamp]:
    folder = Path(os.environ.get("TORCHPRT_DATA") or ROOT.parent / "shared" / "data")
    found = sorted((folder / "hdri").glob("*.exr"))
    return {f"photograph: {path.stem}": of_image(light.read_with_report(path, repair=True)[0]) for path in found}


def lamps() -> dict[str, Lamp]:
    made = {name: of_image(light.built_in(name, HEIGHT)) for name in light.BUILT_IN if name != "white"}
    return made | {"disc of 5 degrees": of_disc(5.0), "clear sky, true sun": sun_and_sky()} | photographs()


def scenes() -> dict[str, Scene]:
    return {
        "sculpture": samples.organic(10_000, 1.0),
        "head": samples.head(6_000, 1.0),
        "teapot": samples.teapot(8_000),
    }


class Shaded:
    """Some white receivers of a scene, shadowed: by rays, and by transfer of any order."""

    def __init__(self, scene: Scene, order: int) -> None:
        geometry = scene.geometry()
        usable = (geometry.receiver_normals != 0).any(-1).nonzero()[:, 0]
        chosen = usable[torch.randperm(len(usable), generator=torch.Generator().manual_seed(0))[:RECEIVERS]]
        self.points, self.normals = geometry.receiver_positions[chosen], geometry.receiver_normals[chosen]
        self.tracer = Tracer(geometry.positions, geometry.faces)
        self.transfer: Transfer = bake(
            scene, order=order, rays=RAYS, receivers=Points(self.points, self.normals, 1.0), progress=False
        )

    def traced(self, lamp: Lamp) -> Tensor:
        origins = self.tracer.origins(self.points, self.normals)
        world = torch.eye(3).expand(1, 3, 3)
        rows = []
        for origin, normal in zip(origins, self.normals.double(), strict=True):
            seen = self.tracer.visibility(origin[None], world, lamp.directions.float())[0].double()
            rows.append((seen * (lamp.directions @ normal).clamp(min=0)) @ lamp.power / math.pi)
        return torch.stack(rows)

    def under(self, lamp: Tensor) -> Tensor:
        return shader(self.transfer.to_order(sh.order_of(len(lamp))), dtype=torch.float64)(lamp)


@dataclass
class Found:
    """Of one light, order and window: of the light, relative to its mean and to the peak of what it stands for; of the
    shading, RMS error, the least relative to the mean, and the share of receivers that are negative; means of scenes,
    the worst of the least."""

    least: float
    peak: float
    error: float = 0.0
    lowest: float = 0.0
    negative: float = 0.0


def measured(
    chosen: Mapping[str, Lamp], orders: Sequence[int], tell: Callable[[str], None]
) -> dict[tuple[str, int, str], Found]:
    made: dict[tuple[str, int, str], Found] = {}
    under: dict[tuple[str, int, str], Tensor] = {}
    directions, _ = sh.fibonacci(20_000)
    for name, lamp in chosen.items():
        tell(name)
        for order in orders:
            plain = lamp.project(order)
            for window in light.WINDOWS:
                key = name, order, window
                under[key] = light.windowed(plain, window)
                values = sh.evaluate(under[key], directions)
                made[key] = Found(float(values.min() / values.mean()), float(values.max()) / lamp.peak)
    bodies = scenes()
    for body, scene in bodies.items():
        tell(body)
        receivers = Shaded(scene, max(orders))
        for name, lamp in chosen.items():
            wanted = receivers.traced(lamp)
            mean, size = wanted.mean(), wanted.square().mean().sqrt()
            for order in orders:
                for window in light.WINDOWS:
                    shown = receivers.under(under[name, order, window])
                    found = made[name, order, window]
                    found.error += float((shown - wanted).square().mean().sqrt() / size) / len(bodies)
                    found.lowest = min(found.lowest, float(shown.min() / mean))
                    found.negative += float((shown < -SEEN * mean).any(-1).double().mean()) / len(bodies)
    return made


def glossy(chosen: Mapping[str, Lamp], tell: Callable[[str], None]) -> dict[tuple[int, str], Found]:
    """Means over lights of what a glossy teapot sends, against as many rays under lights of order `HIGH`."""
    few, rows = sample_receivers(samples.teapot(8_000, Material(0.0, gloss="ggx:0.3")), GLOSSY)
    views = hemisphere(VIEWS, 1)
    made = {(order, window): Found(0.0, 0.0) for order in GLOSSY_ORDERS for window in light.WINDOWS}
    plain = torch.stack([lamp.project(HIGH) for lamp in chosen.values()])
    wanted = exit_radiance_by_brute_force(few, rows, views, plain, rays=2 * RAYS, seed=1)
    for order in GLOSSY_ORDERS:
        tell(f"gloss, order {order}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", OrderWarning)
            transfer = bake(few, order=order, rays=RAYS, progress=False)
        module = shader(sample_transfer(transfer, rows), dtype=torch.float64)
        for window in light.WINDOWS:
            found = exit_radiance(module, views, light.windowed(plain[:, : order**2], window))
            total = made[order, window]
            for shown, exact in zip(found, wanted, strict=True):
                total.error += float((shown - exact).square().mean().sqrt() / exact.square().mean().sqrt()) / len(plain)
                total.lowest = min(total.lowest, float(shown.min() / exact.mean()))
                total.negative += float((shown < -SEEN * exact.mean()).any(-1).double().mean()) / len(plain)
    return made


def table(rows: Mapping[str, Sequence[str]], head: str) -> str:
    lines = [f"| {head} | {' | '.join(light.WINDOWS)} |", "|---" * (len(light.WINDOWS) + head.count("|") + 1) + "|"]
    lines += [f"| {name} | {' | '.join(cells)} |" for name, cells in rows.items()]
    return "\n".join(lines) + "\n"


def mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def page(
    names: Sequence[str] = (), orders: Sequence[int] = ORDERS, tell: Callable[[str], None] = lambda _: None
) -> str:
    chosen = {name: lamp for name, lamp in lamps().items() if not names or name in names}
    found = measured(chosen, orders, tell)
    gloss = glossy(chosen, tell)

    def over(order: int, window: str) -> list[Found]:
        return [found[name, order, window] for name in chosen]

    def costs(order: int, window: str) -> str:
        some = over(order, window)
        worst, share = min(each.lowest for each in some), mean([each.negative for each in some])
        return f"{mean([each.error for each in some]):.1%} ({worst:.2f}, {share:.2%})"

    def each_light(of: Callable[[Found], str]) -> str:
        rows = {
            f"{name} | {order}": [of(found[name, order, window]) for window in light.WINDOWS]
            for name in chosen
            for order in orders
        }
        return table(rows, "light | order")

    shading = table({str(order): [costs(order, window) for window in light.WINDOWS] for order in orders}, "order")
    mirrored = table(
        {
            str(order): [
                f"{each.error:.1%} ({each.lowest:.2f}, {each.negative:.1%})"
                for each in (gloss[order, window] for window in light.WINDOWS)
            ]
            for order in GLOSSY_ORDERS
        },
        "order",
    )
    bodies = ", ".join(scenes())
    return "\n".join(
        [
            HEAD.format(narrowest=NARROWEST),
            "## What a window costs diffuse surfaces\n",
            f"Means over {len(chosen)} lights and {len(scenes())} scenes ({bodies}; {RECEIVERS} white, shadowed\n"
            f"receivers of each, {RAYS} rays): RMS error of radiance against rays to every texel; in brackets the\n"
            "lowest radiance of any receiver under any light, relative to the mean (0 if none is negative), and the\n"
            f"share of receivers below -{SEEN:.0%} of the mean.\n",
            shading,
            advice(orders, over),
            "## What it costs gloss\n",
            f"A teapot of `ggx:0.3`, {GLOSSY} receivers toward {VIEWS} directions, against rays under the light of\n"
            f"order {HIGH} without a window; as above.\n",
            mirrored,
            advice(GLOSSY_ORDERS, lambda order, window: [gloss[order, window]]),
            "## The lights\n",
            "The least radiance, relative to the mean; behind it the largest, relative to that of what is projected\n"
            f"(of an image averaged to {TEXELS} rows): above 1 it overshoots, below 1 the order or the window blurs.\n",
            each_light(lambda each: f"{each.least:.2f}, {each.peak:.2g}"),
            "## The shading under each\n",
            "RMS error as above, and the lowest radiance relative to the mean.\n",
            each_light(lambda each: f"{each.error:.1%} ({each.lowest:.2f})"),
        ]
    )


def advice(orders: Sequence[int], over: Callable[[int, str], list[Found]]) -> str:
    """What the figures say, and no more."""
    lines = []
    for order in orders:
        none, auto, least = (over(order, window) for window in ("none", "auto", "least"))
        more = mean([a.error - n.error for a, n in zip(auto, none, strict=True)])
        less = mean([b.error - a.error for a, b in zip(auto, least, strict=True)])
        left, before = (mean([each.negative for each in some]) for some in (auto, none))
        lines.append(
            f"- Order {order}: auto costs {100 * more:.1f} points more than none and {100 * less:.1f} less than least; "
            f"it leaves {left:.2%} of the receivers negative, none {before:.2%}."
        )
    return "\n".join(lines) + "\n"


def run() -> None:
    torch.set_num_threads(1)
    parser = argparse.ArgumentParser(description="Writes how far lights ring, and what windows cost.")
    parser.add_argument("page", nargs="?", type=Path, default=ROOT / "docs" / "ringing.md")
    parser.add_argument("--lights", nargs="+", default=(), metavar="NAME")
    parser.add_argument("--orders", nargs="+", type=int, default=ORDERS, metavar="N")
    given = parser.parse_args()
    text = page(given.lights, given.orders, lambda line: print(line, file=sys.stderr, flush=True))
    given.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    run()
