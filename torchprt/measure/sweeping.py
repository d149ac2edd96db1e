"""The work of a sweep: what is not known of its recipes is measured, bake after bake, then put together."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.measure.front import Point
from torchprt.measure.keep import Kept, key_of
from torchprt.measure.model import Runner, frame_of, light_under, runner_of, store_recipe
from torchprt.measure.recipe import Recipe
from torchprt.measure.recipe_error import errors_under
from torchprt.measure.side_by_side import MOST_BYTES, TOGETHER, SideBySide
from torchprt.measure.subject import Subject
from torchprt.measure.sweep import Choice, sweep
from torchprt.measure.views import Views
from torchprt.measure.whole import Whole
from torchprt.progress import Report, Silent
from torchprt.transfer import Transfer

# Seconds that a step takes, about: an error with its pictures, and what a runtime takes to be made and timed.
_ERROR, _RUN = 0.5, {"eager": 0.4, "onnx": 3.0, "compiled": 12.0}
# Bytes of transfer whose graphs are kept until they are timed.
_SMALL = 1 << 26
# Multiplications of clustered PCA and of fitting a lobe in a second, about.
_CLUSTERED, _FITTED = 3e8, 1e6


class Sweeping:
    """A sweep of `subject`; its reference is baked when this is made, and everything else by `points`.

    `lights [N, 3]` of the order of the reference or more; `recipes` those of `sweep` if None.
    """

    def __init__(
        self,
        subject: Subject,
        lights: Mapping[str, Float[Tensor, "N 3"]],
        eyes: Float[Tensor, "E 3"] | None,
        recipes: Sequence[Recipe] | None,
        quick: bool,
        kept: Kept,
        report: Report,
    ):
        self.subject, self.kept = subject, kept
        best = subject.choice.reference
        self._lights = {name: light[: best.order**2] for name, light in lights.items()}
        # Before anything is baked: eyes may see nothing.
        self.views = Views(subject.receivers, list(self._lights.values()), eyes)

        def chosen(choice: Choice) -> list[Recipe]:
            return sweep(choice, quick) if recipes is None else list(dict.fromkeys(recipes))

        # A guess of the whole: how many bounces there are to choose from is told by the reference.
        first = subject.expected(subject.choice.reference)
        guess = chosen(subject.choice)
        self._whole = Whole(report, "tradeoff", first + self._seconds(guess, guess))
        with self._whole.step(first) as step:
            transfer = subject.begin(step)
        self.recipes = chosen(subject.choice)
        self._check_recipes()
        subject.compare(self.recipes[0])
        self._by_eye = "eye" in transfer.needs
        best = subject.choice.reference
        self.wanted = self._shaded(runner_of(transfer, best), best)
        self._pictures = self.views.pictures(self.wanted)
        self._seen_key = key_of("seen", [*self._lights.values(), self.views.eyes], names=list(lights))
        # Graphs and compiled modules, which take seconds to be made, from when they are tried until they are timed.
        self._made: dict[Recipe, Runner] = {}
        self._times = SideBySide(kept, self.recipes[0], self._shapes)

    def points(self) -> list[Point]:
        """Measures what is not known, and puts all of it together."""
        unknown = [recipe for recipe in self.recipes if self.kept.record(self._error_key(recipe)) is None]
        # One of each shape.
        untimed = {self._times.key(recipe): recipe for recipe in self.recipes if not self._times.known(recipe)}
        self._whole.expect(self._seconds(unknown, list(untimed.values())))
        for group in self._by_bake(unknown):
            with self._whole.step(self.subject.expected(group[0])) as step:
                self.subject.baked(group[0], step)
            for recipe in group:
                with self._whole.step(self._measure_seconds(recipe)) as step:
                    self._measure(recipe, step)
        with self._whole.step(self.subject.more_seconds) as step:
            self.subject.more(step)
        self._time(list(untimed.values()))
        self._whole.end()
        return self._assembled()

    def radiance(self, point: Point) -> Float[Tensor, "V 3"]:
        """Under the first light from the first eye, run eagerly: what another runtime changes is rounding."""
        return self._frame(point.recipe.replace(runtime="eager"))()[0].float()

    def _shapes(self, recipe: Recipe) -> dict[str, Any]:
        """What the time of a frame depends on beside its recipe; of an adaptive one also all values."""
        known: dict[str, Any] = {"subject": self.subject.key, "channels": self.subject.channels(recipe)}
        return known if recipe.adaptive is None else {**known, "values": self._error_key(recipe)}

    def _seconds(self, unknown: list[Recipe], untimed: list[Recipe]) -> float:
        """How long all this takes, about."""
        bakes = sum(self.subject.expected(group[0]) for group in self._by_bake(unknown)) + self.subject.more_seconds
        return bakes + sum(map(self._measure_seconds, unknown)) + sum(_RUN[recipe.runtime] for recipe in untimed)

    def _by_bake(self, recipes: list[Recipe]) -> list[list[Recipe]]:
        groups: dict[str, list[Recipe]] = {}
        for recipe in recipes:
            groups.setdefault(self.subject.key_of_bake(recipe), []).append(recipe)
        return list(groups.values())

    def _measure_seconds(self, recipe: Recipe) -> float:
        return _ERROR + self._store_seconds(recipe) + _RUN[recipe.runtime]

    def _measure(self, recipe: Recipe, report: Report) -> None:
        transfer, seconds = self._stored(recipe, report)
        run = runner_of(transfer, recipe)
        found = self._shaded(run, recipe)
        if recipe.runtime != "eager" and transfer.bytes < _SMALL:
            self._made[recipe] = run
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
        if record is not None and self.kept.has_transfer(key):
            return self.kept.transfer(key), float(record["seconds"])
        dense = self.subject.baked(recipe, report)
        start = time.process_time()
        stored = store_recipe(dense, recipe, report)
        spent = time.process_time() - start
        self.kept.keep_transfer(key, stored)
        self.kept.keep(key, {"seconds": spent, "recipe": recipe.name})
        return stored, spent

    def _store_seconds(self, recipe: Recipe) -> float:
        """How long it takes to store, about."""
        rows = 1 if recipe.frame is None else (recipe.output_order or recipe.order) ** 2
        numbers = self.subject.choice.receivers * recipe.order**2 * rows
        if recipe.clusters is not None and recipe.components is not None:
            return 1 + numbers * recipe.clusters * recipe.components / _CLUSTERED
        return 0.0 if recipe.lobes is None else 1 + numbers * recipe.lobes**2 / _FITTED

    def _time(self, recipes: list[Recipe]) -> None:
        while recipes:
            frames: dict[Recipe, Callable[[], Any]] = {}
            size = 0
            while recipes and len(frames) < TOGETHER and size < MOST_BYTES:
                recipe = recipes.pop(0)
                with self._whole.step(_RUN[recipe.runtime]):
                    frames[recipe] = self._frame(recipe)
                size += int((self.kept.record(self._error_key(recipe)) or {"bytes": 0})["bytes"])
            self._times.time(frames, frames.get(self.recipes[0]) or self._frame(self.recipes[0]))
            # torch compiles the code of a module a few times only, unless it forgets.
            torch.compiler.reset()

    def _frame(self, recipe: Recipe) -> Callable[[], Tensor]:
        light, eye = next(iter(self._lights.values()))[None], self.views.eyes[0]
        run = self._made.pop(recipe, None)
        if run is None:
            return frame_of(self._stored(recipe, Silent())[0], recipe, light, eye)
        used = light_under(recipe, light).float()
        return lambda: run(used, eye)

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
        points = []
        for recipe, timing in zip(self.recipes, self._times.timings(self.recipes), strict=True):
            record = self.kept.record(self._error_key(recipe)) or {}
            seconds, how = self.subject.seconds(recipe)
            point = Point(
                recipe,
                max(record["errors"]),
                record["psnr"],
                record["flip"],
                timing,
                record["bytes"],
                seconds,
                how,
                record["store_seconds"],
                dict(zip(self._lights, record["errors"], strict=True)),
            )
            points.append(point)
        return points

    def _check_recipes(self) -> None:
        most = self.subject.choice.reference.order
        if not self.recipes:
            raise InputError("a sweep needs recipes: give one or more")
        for recipe in self.recipes:
            if recipe.order > most:
                raise InputError(f"the recipe '{recipe.name}' has more bands than the reference, {most}: raise order")
