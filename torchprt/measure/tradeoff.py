"""Speed for accuracy on a scene: recipes measured side by side."""

from __future__ import annotations

import contextlib
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.measure.front import Point
from torchprt.measure.keep import Kept, default_folder, key_of
from torchprt.measure.model import Runner, frame_of, light_under, runner_of, store_recipe
from torchprt.measure.recipe import Recipe
from torchprt.measure.recipe_error import errors_under
from torchprt.measure.subject import FileSubject, SceneSubject, Subject
from torchprt.measure.sweep import sweep
from torchprt.measure.time import Timing, time_it
from torchprt.measure.views import Views
from torchprt.measure.whole import Whole
from torchprt.progress import Report, Silent
from torchprt.scene import Scene
from torchprt.sh import order_of
from torchprt.transfer import Transfer
from torchprt.transport.progress import Bar
from torchprt.transport.workers import torch_on_one_thread

ORDER, GLOSSY_ORDER, RAYS = 10, 8, 4096
"""Of the reference: bands for diffuse and for glossy scenes, rays a receiver."""
ROUNDS = 9
# Of recipes that are timed side by side: how many, and how many bytes they may take together.
_SIDE_BY_SIDE, _MOST_BYTES = 12, 1 << 30
# Seconds that a step takes, about: an error with its pictures, and what a runtime takes to be made and timed.
_ERROR, _RUN = 0.4, {"eager": 0.4, "onnx": 4.0, "compiled": 15.0}
# Multiplications of clustered PCA and of fitting a lobe in a second, about.
_CLUSTERED, _FITTED = 3e8, 1e6


@dataclass(frozen=True, eq=False)
class Tradeoff:
    """What a sweep found: `points` in the order in which they were tried, the base first.

    `reference`: what errors are against. `base`: what a bake makes unless told otherwise, or the bake that was given.
    `lights` by name, and the `views` that pictures are of; `radiance(point)` is what it gives under the first light.
    """

    name: str
    points: tuple[Point, ...]
    reference: Recipe
    lights: Mapping[str, Float[Tensor, "N 3"]]
    views: Views
    wanted: Float[Tensor, "V 3"]
    radiance: Callable[[Point], Float[Tensor, "V 3"]]

    @property
    def base(self) -> Point:
        """The point that others are compared with."""
        return self.points[0]


@torch_on_one_thread()
def tradeoff(
    source: Scene | Transfer,
    lights: Mapping[str, Float[Tensor, "N 3"]],
    eyes: Float[Tensor, "E 3"] | None = None,
    *,
    order: int | None = None,
    rays: int = RAYS,
    recipes: Sequence[Recipe] | None = None,
    quick: bool = False,
    cache: str | os.PathLike[str] | None = None,
    threads: int | None = None,
    progress: bool | Report = True,
    name: str = "",
) -> Tradeoff:
    """Sweeps what can be chosen for a scene, or for a bake after it was made, and measures each choice.

    - `lights [N, 3]` by name, without a window, of the order of the reference or more: `order`, by default 10, for a
      glossy scene 8, for a bake its own. The reference has so many bands, in glossy scenes also toward the eye, `rays`
      a receiver, and bounces until light is spent; a bake is its own reference.
    - `eyes`: where pictures are seen from, and for what glossy surfaces are shaded; the usual camera if omitted.
    - `recipes`: which to try, the first being what others are compared with; those of `sweep` if omitted, fewer of
      them if `quick`.
    - `cache`: a folder that keeps bakes and measurements by what they are of; `torchprt/tradeoff` in XDG_CACHE_HOME
      or `~/.cache` if omitted. What it holds is not measured again, whatever the sweep; a sweep that is stopped goes
      on from there.
    - `threads` of bakes. Frames are timed on one thread.
    The error of a recipe is that under the light which it serves worst, see `error_under`, over all receivers and
    eyes, by what the recipe runs: in its types and its runtime.

    Raises InputError without lights, if one has too few bands, if recipes ask for more than the reference has, if a
    bake leaves its reflectance open, as `bake`, `compress` and `fit`, without flip-evaluator, and if the cache cannot
    be written; KeyboardInterrupt with all that was measured kept.
    """
    if not lights:
        raise InputError("a sweep needs a light: give one or more")
    kept = Kept(default_folder() if cache is None else cache)
    with _reported(progress) as report:
        sweeping = _Sweep(source, lights, eyes, order, rays, recipes, quick, kept, threads, report)
        points = sweeping.points()
    return Tradeoff(
        name or ("scene" if isinstance(source, Scene) else "bake"),
        tuple(points),
        sweeping.subject.choice.reference,
        lights,
        sweeping.views,
        sweeping.wanted[0][0],
        sweeping.radiance,
    )


@contextlib.contextmanager
def _reported(progress: bool | Report) -> Iterator[Report]:
    if progress is True:
        with Bar() as bar:
            yield bar
    else:
        yield Silent() if progress is False else progress


class _Sweep:
    def __init__(
        self,
        source: Scene | Transfer,
        lights: Mapping[str, Tensor],
        eyes: Tensor | None,
        order: int | None,
        rays: int,
        recipes: Sequence[Recipe] | None,
        quick: bool,
        kept: Kept,
        threads: int | None,
        report: Report,
    ):
        self.kept, self._report = kept, report
        self.subject: Subject
        if isinstance(source, Scene):
            glossy = source.requires().kind == "glossy"
            order = order or (GLOSSY_ORDER if glossy else ORDER)
            _check_lights(lights, order)
            scene = SceneSubject(source, kept, order=order, rays=rays, output_order=order, threads=threads)
            bake = scene.expected(scene.choice.reference)
            whole = Whole(report, "reference", bake)
            with whole.step(bake) as step:
                scene.follow(step)
            whole.end()
            self.subject, self._scene = scene, scene
        else:
            _check_lights(lights, source.order)
            self.subject, self._scene = FileSubject(source), None
        choice = self.subject.choice
        self.recipes = list(dict.fromkeys(recipes)) if recipes is not None else sweep(choice, quick)
        self._check_recipes()
        self._lights = {name: light[: choice.reference.order**2] for name, light in lights.items()}
        best = self.subject.baked(choice.reference, Silent())
        self.views = Views(best.receivers, list(self._lights.values()), eyes)
        self._by_eye = "eye" in best.needs
        self.wanted = self._shaded(runner_of(best, choice.reference), choice.reference)
        self._pictures = self.views.pictures(self.wanted)
        self._seen_key = key_of("seen", [*self._lights.values(), self.views.eyes], names=list(lights))

    def points(self) -> list[Point]:
        """Measures what is not known, in the order of bakes, and then puts all of it together."""
        unknown = [recipe for recipe in self.recipes if self.kept.record(self._error_key(recipe)) is None]
        untimed = {self._time_key(each): each for each in self.recipes if self._timing(each) is None}
        by_bake: dict[str, list[Recipe]] = {}
        for recipe in unknown:
            by_bake.setdefault(self.subject.key_of_bake(recipe), []).append(recipe)
        seconds = sum(self.subject.expected(group[0]) for group in by_bake.values())
        seconds += sum(_ERROR + self._store_seconds(recipe) + _RUN[recipe.runtime] for recipe in unknown)
        seconds += sum(_RUN[recipe.runtime] for recipe in untimed.values())
        if self._scene is not None:
            seconds += self.subject.expected(self.subject.choice.base)
        whole = Whole(self._report, "tradeoff", seconds)
        for group in by_bake.values():
            with whole.step(self.subject.expected(group[0])) as step:
                self.subject.baked(group[0], step)
            for recipe in group:
                with whole.step(_ERROR + self._store_seconds(recipe) + _RUN[recipe.runtime]) as step:
                    self._measure(recipe, step)
        if self._scene is not None:
            with whole.step(self.subject.expected(self.subject.choice.base)) as step:
                self._scene.time_lowest(min(2, self.subject.choice.reference.order), step)
        self._time_all(list(untimed.values()), whole)
        whole.end()
        return self._assembled()

    def radiance(self, point: Point) -> Float[Tensor, "V 3"]:
        """Under the first light from the first eye, shaded as it is: what another runtime changes is rounding."""
        recipe = point.recipe.replace(runtime="eager")
        light = next(iter(self._lights.values()))
        frame = frame_of(self._stored(recipe, Silent())[0], recipe, light[None], self.views.eyes[0])
        return frame()[0].float()

    # What is measured.

    def _measure(self, recipe: Recipe, report: Report) -> None:
        transfer, seconds = self._stored(recipe, report)
        found = self._shaded(runner_of(transfer, recipe), recipe)
        errors = errors_under(found, self.wanted)
        quality, seen = self.views.compare(self.views.pictures(found), self._pictures)
        record = {"recipe": recipe.name, "errors": errors, "psnr": quality, "flip": seen}
        self.kept.keep(self._error_key(recipe), {**record, "bytes": transfer.bytes, "store_seconds": seconds})

    def _shaded(self, run: Runner, recipe: Recipe) -> list[Float[Tensor, "E V 3"]]:
        """Under every light, toward every eye."""
        found = []
        for light in self._lights.values():
            used = light_under(recipe, light[None]).float()
            eyes = self.views.eyes if self._by_eye else self.views.eyes[:1]
            found.append(torch.stack([run(used, eye)[0].float() for eye in eyes]))
        return found

    def _stored(self, recipe: Recipe, report: Report) -> tuple[Transfer, float]:
        """What the recipe stores, and the CPU seconds that it took to compress it."""
        if recipe.clusters is None and recipe.lobes is None:
            return store_recipe(self.subject.baked(recipe, report), recipe, report), 0.0
        key = key_of("store", bake=self.subject.key_of_bake(recipe), order=recipe.order, **recipe.part("store"))
        record = self.kept.record(key)
        if record is None or not self.kept.has_transfer(key):
            dense = self.subject.baked(recipe, report)
            start = time.process_time()
            stored = store_recipe(dense, recipe, report)
            spent = time.process_time() - start
            self.kept.keep_transfer(key, stored)
            self.kept.keep(key, {"seconds": spent, "recipe": recipe.name})
            return stored, spent
        return self.kept.transfer(key), float(record["seconds"])

    def _store_seconds(self, recipe: Recipe) -> float:
        """How long it takes to store, about."""
        choice = self.subject.choice
        rows = 1 if recipe.frame is None else (recipe.output_order or recipe.order) ** 2
        numbers = choice.receivers * recipe.order**2 * rows
        if recipe.clusters is not None and recipe.components is not None:
            return 1 + numbers * recipe.clusters * recipe.components / _CLUSTERED
        return 0.0 if recipe.lobes is None else 1 + numbers * recipe.lobes**2 / _FITTED

    # What is timed.

    def _time_all(self, recipes: list[Recipe], whole: Whole) -> None:
        """Side by side with the base, a few at a time: what slows the machine slows the base as well."""
        while recipes:
            names = {}
            size = 0
            while recipes and len(names) < _SIDE_BY_SIDE and (not names or size < _MOST_BYTES):
                recipe = recipes.pop(0)
                with whole.step(_RUN[recipe.runtime]):
                    names[recipe] = self._frame(recipe)
                record = self.kept.record(self._error_key(recipe))
                size += 0 if record is None else int(record["bytes"])
            base = names.get(self.recipes[0]) or self._frame(self.recipes[0])
            found = time_it({"base": base, **{self._time_key(each): call for each, call in names.items()}}, rounds=ROUNDS)
            beside = found.pop("base").median
            for key, timing in found.items():
                self.kept.keep(key, {**vars(timing), "base": beside})
            # Graphs of others are not compiled for these.
            torch.compiler.reset()

    def _frame(self, recipe: Recipe) -> Callable[[], Any]:
        light = next(iter(self._lights.values()))
        return frame_of(self._stored(recipe, Silent())[0], recipe, light[None], self.views.eyes[0])

    def _timing(self, recipe: Recipe) -> dict[str, Any] | None:
        return self.kept.record(self._time_key(recipe))

    def _time_key(self, recipe: Recipe) -> str:
        """What a frame takes depends on: shapes, how they are stored and run, and the machine; not on their values."""
        shapes = {name: value for name, value in recipe.part("bake").items() if name not in ("rays", "bounces", "shadows")}
        base = self.recipes[0]
        return key_of(
            "time",
            subject=self.subject.key,
            channels=self.subject.channels(recipe),
            beside=[*base.part("bake", "store", "run").items()],
            machine=[platform.node(), platform.machine(), torch.__version__],
            **shapes,
            **recipe.part("store", "run"),
        )

    def _error_key(self, recipe: Recipe) -> str:
        best = self.subject.choice.reference
        return key_of(
            "error",
            bake=self.subject.key_of_bake(recipe),
            reference=self.subject.key_of_bake(best),
            seen=self._seen_key,
            order=recipe.order,
            best=best.order,
            **recipe.part("light", "store", "run"),
        )

    def _assembled(self) -> list[Point]:
        timings = [self._timing(recipe) for recipe in self.recipes]
        # All in the time that the base took in the middle of its runs.
        base = statistics.median(each["base"] for each in timings if each is not None)
        points = []
        for recipe, timing in zip(self.recipes, timings, strict=True):
            record = self.kept.record(self._error_key(recipe))
            assert record is not None and timing is not None
            scale = base / timing["base"]
            seconds, how = self.subject.seconds(recipe)
            points.append(
                Point(
                    recipe,
                    max(record["errors"]),
                    record["psnr"],
                    record["flip"],
                    Timing(timing["median"] * scale, timing["spread"], timing["best"] * scale, timing["rounds"]),
                    record["bytes"],
                    seconds,
                    how,
                    record["store_seconds"],
                    dict(zip(self._lights, record["errors"], strict=True)),
                )
            )
        return points

    def _check_recipes(self) -> None:
        best = self.subject.choice.reference
        if not self.recipes:
            raise InputError("a sweep needs recipes: give one or more")
        for recipe in self.recipes:
            if recipe.order > best.order:
                raise InputError(
                    f"the recipe '{recipe.name}' has more bands than the {best.order} of the reference: raise order"
                )


def _check_lights(lights: Mapping[str, Tensor], order: int) -> None:
    for name, light in lights.items():
        if order_of(len(light)) < order:
            raise InputError(
                f"light '{name}' has {order_of(len(light))} bands, the reference {order}: project it to as many"
            )
