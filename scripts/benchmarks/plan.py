"""Does a plan keep what it promises, and how near is it to the cheapest there is?

    python scripts/benchmarks/plan.py [NAME ...]

Every scene of the project's own (and the bunny where TORCHPRT_DATA names it) is planned for a few lights and errors,
baked whole as planned, and compared with a bake of the whole scene at the order of the lights, with 4096 rays of
another seed and all bounces. Then a grid of recipes is measured against the same reference (diffuse: all orders, rays
64 to 1024, bounces, types, and clusters where they are planned; glossy: orders and frames): the cheapest of those that
keep to the error is what a whole sweep would have found. Milliseconds are CPU time of one thread, interleaved.
"""

import itertools
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator

import torch
from bake import scene_to_measure
from rich.console import Console

from torchprt import light as lights
from torchprt.measure import Recipe, Table, bake_recipe, error_under, frame_of, plan, store_recipe, time_it
from torchprt.measure.plan import eyes_around
from torchprt.scene import Material, Object, Scene, samples
from torchprt.transfer import Transfer

ORDER, RAYS = 8, 4096
GLOSSY_RAYS = 1024


def shiny(scene: Scene, gloss: str) -> Scene:
    return Scene([Object(each.mesh, Material(0.2, gloss=gloss, specular=0.5), each.role) for each in scene.objects])


# By name: a scene, its lights, the error that is asked for, and what is to be least.
CASES: dict[str, tuple[Callable[[], Scene], tuple[str, ...], float, str]] = {
    "box": (lambda: samples.coloured_box(24), ("studio", "sky"), 0.05, "milliseconds"),
    "cylinder": (samples.cylinder, ("sunset",), 0.02, "bytes"),
    "head": (samples.head, ("studio",), 0.01, "milliseconds"),
    "organic": (lambda: samples.organic(16_000), ("sky", "overcast"), 0.02, "milliseconds"),
    "plane": (lambda: samples.plane_and_blocker(96), ("three-point",), 0.02, "bytes"),
    "still": (lambda: samples.still_life(32), ("studio", "sunset"), 0.1, "milliseconds"),
    "vase": (lambda: samples.vase(96), ("overcast",), 0.01, "milliseconds"),
    "painted": (lambda: samples.painted_vase(96), ("sky",), 0.03, "bytes"),
    "wing": (lambda: samples.wing(48), ("studio",), 0.03, "milliseconds"),
    "bunny": (scene_to_measure, ("studio", "sky"), 0.01, "milliseconds"),
    "teapot": (lambda: samples.teapot(8_000), ("studio", "sky"), 0.1, "milliseconds"),
    "shiny": (lambda: shiny(samples.organic(8_000), "phong:12"), ("overcast",), 0.05, "bytes"),
}


def radiance(transfer: Transfer, recipe: Recipe, light: torch.Tensor, eyes: torch.Tensor) -> torch.Tensor:
    if "eye" not in transfer.needs:
        return frame_of(transfer, recipe, light)()[:, None]
    return torch.stack([frame_of(transfer, recipe, light, eye)() for eye in eyes], 1)


def swept(scene: Scene, planned: Recipe, bounces: int) -> Iterator[tuple[Recipe, Transfer]]:
    """Recipes of a grid and what they store; those that differ in what is stored alone share their bake."""
    glossy = planned.frame is not None
    frames: list[dict[str, object]] = [{}]
    if glossy:
        frames = [{"frame": "exit", "output_order": order} for order in (3, 4, 5, 6)]
        frames += [{"frame": "visibility", "visibility_order": order} for order in (4, 6, 8)]
        frames += [{"frame": "exit", "factors": factors} for factors in (2, 4, 8)]
    rays = (64, 256) if glossy else (64, 128, 256, 512, 1024)
    for frame, count, number in itertools.product(frames, rays, range(min(bounces, 3) + 1)):
        if number and frame.get("frame") == "visibility":
            continue
        whole = Recipe(order=ORDER, rays=count, bounces=number, **frame)  # type: ignore[arg-type]
        baked = bake_recipe(scene, whole, progress=False)
        for order, dtype in itertools.product(range(2, ORDER + 1), ("float32", "float16", "bfloat16")):
            recipe = whole.replace(order=order, dtype=dtype)
            layers = {name: layer.to_order(order) for name, layer in baked.layers.items()}
            yield recipe, store_recipe(baked.with_layers(**layers), recipe)
        if planned.clusters is None or glossy or count not in (256, 1024) or number != planned.bounces:
            continue
        for order, clusters, components in itertools.product(range(4, ORDER + 1), (16, 64, 256), (1, 2, 4, 8)):
            recipe = whole.replace(order=order, clusters=clusters, components=components, bits=8)
            layers = {name: layer.to_order(order) for name, layer in baked.layers.items()}
            yield recipe, store_recipe(baked.with_layers(**layers), recipe)
    flat = Recipe(order=ORDER, shadows=False, **frames[0])  # type: ignore[arg-type]
    baked = bake_recipe(scene, flat, progress=False)
    for order in range(2, ORDER + 1):
        layers = {name: layer.to_order(order) for name, layer in baked.layers.items()}
        yield flat.replace(order=order), baked.with_layers(**layers)


def run(names: list[str]) -> None:
    torch.set_num_threads(1)
    table = Table(f"plans at order {ORDER}: predicted, achieved, and against the cheapest of a sweep")
    met, cheap, compared = 0, 0, 0
    for name in names:
        make, words, error, least = CASES[name]
        scene = make()
        light = torch.stack([lights.project(lights.built_in(word), ORDER) for word in words])
        eyes = eyes_around(scene)
        start = time.perf_counter()
        found = plan(scene, light, error=error, least=least)  # type: ignore[arg-type]
        taken = time.perf_counter() - start
        glossy = found.recipe.frame is not None
        exact = Recipe(order=ORDER, rays=GLOSSY_RAYS if glossy else RAYS)
        if glossy:
            exact = exact.replace(frame="exit", output_order=8)
        reference = bake_recipe(scene, exact, progress=False, seed=7, bounces=math.inf)
        wanted = radiance(reference, exact, light, eyes)
        start = time.perf_counter()
        made = store_recipe(bake_recipe(scene, found.recipe, progress=False), found.recipe)
        seconds = time.perf_counter() - start
        achieved = error_under(radiance(made, found.recipe, light, eyes), wanted)
        best: dict[str, tuple[Recipe, Transfer]] = {}
        count = 0
        for recipe, stored in swept(scene, found.recipe, int(reference.bounces)):
            count += 1
            if error_under(radiance(stored, recipe, light, eyes), wanted) > error:
                continue
            # One of each shape: rays and bounces of one channel change neither time nor bytes.
            changes = {"rays": 1, "bounces": 0} if recipe.shadows else {}
            key = f"{recipe.replace(**changes).name} {stored.channels}"
            best.setdefault(key, (recipe, stored))
        frames = {key: frame_of(stored, recipe, light[:1], eyes[0]) for key, (recipe, stored) in best.items()}
        frames["planned"] = frame_of(made, found.recipe, light[:1], eyes[0])
        times = {key: 1e3 * timing.median for key, timing in time_it(frames, rounds=9).items()}
        sizes = {key: stored.bytes for key, (_, stored) in best.items()} | {"planned": made.bytes}
        costs = times if least == "milliseconds" else sizes
        least_key = min(best, key=lambda key: costs[key], default=None)
        ratio = costs["planned"] / costs[least_key] if least_key is not None else math.nan
        met += achieved <= error
        compared += not math.isnan(ratio)
        cheap += ratio <= 1.5
        predicted = found.predicted
        extra: dict[str, float | int | str] = {
            "predicted, asked": f"{predicted['error']:.2%}, {error:.0%}",
            "ms, predicted": f"{times['planned']:.3g}, {predicted['milliseconds']:.3g}",
            "bake s, predicted": f"{seconds:.3g}, {predicted['seconds']:.3g}",
            "least": least,
            "of the best": "none keeps to it" if math.isnan(ratio) else f"{ratio:.2f}",
            "swept": count,
            "planning, s": f"{taken:.0f}",
        }
        row = table.add(f"{name}: {found.recipe.name}", error=achieved, bytes=made.bytes, extra=extra)
        print(row, best[least_key][0].name if least_key else "none", flush=True)
    Console(width=220).print(table)
    print(f"{met} of {len(names)} keep to the error")
    print(f"{cheap} of the {compared} that can be compared cost at most 1.5 times the best")


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    run(sys.argv[1:] or list(CASES))
