"""The cheapest recipe that is right enough for a scene and its lights, and why."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import exit_error
from torchprt.errors import InputError
from torchprt.measure.cost import frame_costs
from torchprt.measure.plan_clusters import clustered
from torchprt.measure.probe import Probe
from torchprt.measure.reasons import not_required, reasons
from torchprt.measure.recipe import Recipe, Runtime
from torchprt.preview import Orbit
from torchprt.progress import Report, Silent
from torchprt.scene import Scene
from torchprt.sh import order_of
from torchprt.transfer import Transfer

Least = Literal["milliseconds", "bytes", "seconds"]
LEAST = ("milliseconds", "bytes", "seconds")

RAYS = (64, 128, 256, 512, 1024, 2048, 4096)
_OUTPUT_ORDERS, _FACTORS = (2, 3, 4, 5, 6, 8), (2, 4, 8)
# Exit functions of the reference: the first of these that hold the gloss to a quarter of the error.
_REFERENCE_OUTPUT = (5, 6, 8, 10)
# Errors that are sought among where only a cost is given.
_ERRORS = (0.002, 0.003, 0.005, 0.007, 0.01, 0.015, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5)
# Candidates of a kind that are timed.
_TIMED = 4
# Dense recipes that clusters are tried of: bands that are cheap in them leave more of the error to clusters.
_CLUSTERED, _MORE_ORDERS = 3, 2
# Scenes below this are not worth representatives.
_FEWEST_CLUSTERED = 2000
# Differences in time below this are noise: the fewest bytes count among those.
_ALIKE = 1.05
EYES = 4
# Receivers of a probe: matrices are as much work as a hundred vectors.
_MANY, _FEW = 800, 240


@dataclass(frozen=True)
class Plan:
    """A `recipe`, what is predicted of it, and why each of its parts is there.

    `predicted`: "error", "bound" (which the error of all receivers exceeds in about one case of forty),
    "milliseconds" of CPU time a frame of one light, "bytes", "seconds" of a bake on this machine.
    `reasons`: a line for each choice. `not_required`: a line for each thing that the scene does not require.
    """

    recipe: Recipe
    predicted: dict[str, float]
    reasons: tuple[str, ...]
    not_required: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join([self.recipe.name, *self.reasons, *self.not_required])


def plan(
    scene: Scene,
    light: Float[Tensor, "*B N 3"],
    *,
    error: float | int | None = None,
    milliseconds: float | int | None = None,
    bytes: int | None = None,
    least: Least = "milliseconds",
    eyes: Float[Tensor, "E 3"] | None = None,
    runtime: Runtime = "eager",
    window: str = "none",
    count: int | None = None,
    seed: int = 0,
    report: Report | None = None,
) -> Plan:
    """The recipe of the `least` cost whose error under `light` is at most `error`, within the other limits.

    `error`: relative RMS of exit radiance over all receivers under the worst of the lights, against the bands of
    `light` all, unwindowed, with as many rays and bounces as change anything (.01 if no limit is given). With limits
    of `milliseconds` a frame or of `bytes` alone the error is made as small as they allow, to the next of a scale.
    `eyes [E, 3]` (for glossy scenes; some around the scene if omitted): where it will be seen from.
    `runtime`, `window`: of the recipe, given and not sought.

    The scene is not baked: `count` of its receivers are (800, or 240 of a glossy scene), with every number of rays, and
    the whole with a few rays for what bounces add (`Probe`); a frame is timed on their transfer, repeated. Clusters are
    foretold from a sample of receivers and tried on it.

    Raises InputError as `Probe`, if a limit is not above 0, and if no recipe keeps to all of them, with what can.
    """
    _check(error, milliseconds, bytes, least)
    lights = light.reshape(-1, *light.shape[-2:])
    if len(lights) == 0:
        raise InputError("there is no light to plan for: give at least one")
    told = report or Silent()
    goal = 0.01 if error is None and milliseconds is None and bytes is None else error
    glossy = scene.requires().kind == "glossy"
    if glossy and eyes is None:
        eyes = eyes_around(scene)
    wanted_error = goal or _ERRORS[0]
    output = _reference_output(scene, order_of(lights.shape[-2]), wanted_error) if glossy else 1
    few = count or (_FEW if glossy else _MANY)
    probe = Probe(scene, lights, eyes, count=few, output_order=output, seed=seed, report=told)
    search = _Search(scene, probe, runtime, window, least, told)
    found: list[_Priced] = []
    for wanted in (goal,) if goal is not None else _ERRORS:
        found = search.at(wanted, milliseconds, bytes)
        fitting = [each for each in found if _within(each, milliseconds, bytes)]
        if fitting:
            return _told(probe, _least(fitting, least), wanted)
    raise InputError(_impossible(probe, found, goal, milliseconds, bytes, search))


@dataclass(frozen=True)
class _Priced:
    recipe: Recipe
    error: float
    bound: float
    milliseconds: float
    bytes: int
    seconds: float


class _Search:
    """Recipes that keep to an error, and what they cost; nothing is measured twice.

    `nearest`: the least error that any of those tried has.
    """

    def __init__(self, scene: Scene, probe: Probe, runtime: Runtime, window: str, least: Least, told: Report):
        self.scene, self.probe, self.least, self._told = scene, probe, least, told
        self._fixed: dict[str, Any] = {"runtime": runtime, "window": window}
        self._costs: dict[Recipe, tuple[float, int]] = {}
        self.nearest = math.inf

    def at(self, error: float, milliseconds: float | None, bytes: int | None) -> list[_Priced]:
        """The cheapest that keep to the error, priced."""
        dense = sorted(self._dense(error), key=self._numbers)
        if self.least == "seconds":
            dense = sorted(dense, key=self.probe.seconds)
        # Numbers tell of time within a kind of frame only.
        kinds: dict[tuple[object, ...], list[Recipe]] = {}
        for recipe in dense:
            kinds.setdefault((recipe.frame, recipe.factors is None, recipe.shadows), []).append(recipe)
        chosen = [recipe for kind in kinds.values() for recipe in kind[:_TIMED]]
        made = dict.fromkeys(chosen, 0.0)
        if self.probe.receivers >= _FEWEST_CLUSTERED and (self.least == "bytes" or bytes is not None):
            plain = [recipe for recipe in dense if recipe.dtype == "float32"][:_CLUSTERED]
            self._told.start("clusters", len(plain))
            for recipe in plain:
                left = error**2 - self.probe.error(recipe).bound ** 2
                packed = clustered(self.scene, self.probe, recipe, math.sqrt(max(left, 0.0)))
                if packed is not None:
                    made[packed[0]] = packed[1]
                self._told.advance(1)
        self._told.start("timing", len(made))
        self._price(list(made))
        self._told.advance(len(made))
        found = []
        for recipe, lost in made.items():
            estimate = self.probe.error(recipe)
            time, size = self._costs[recipe]
            errors = (math.hypot(estimate.error, lost), math.hypot(estimate.bound, lost))
            found.append(_Priced(recipe, *errors, time, size, self.probe.seconds(recipe)))
        return found

    def _dense(self, error: float) -> Iterator[Recipe]:
        ways, orders = self._ways(), range(1, self.probe.order + 1)
        self._told.start("recipes", len(ways) * len(orders))
        for way in ways:
            first: int | None = None
            for order in orders:
                if self.least != "seconds" and first is not None and order > first + _MORE_ORDERS:
                    # More bands cost more of all but of rays.
                    self._told.advance(len(orders) - order + 1)
                    break
                self._told.advance(1)
                recipe = self._enough(Recipe(order=order, **self._fixed, **way), error)
                if recipe is None:
                    continue
                first = first or order
                yield recipe
                for dtype in ("float16", "bfloat16"):
                    if not (dtype == "bfloat16" and recipe.runtime == "onnx"):
                        narrow = recipe.replace(dtype=dtype)
                        if self.probe.error(narrow).bound <= error:
                            yield narrow

    def _ways(self) -> list[dict[str, Any]]:
        """Frames of gloss; of a diffuse scene the one there is."""
        if not self.probe.glossy:
            return [{}]
        orders = [order for order in _OUTPUT_ORDERS if order <= self.probe.output_order]
        ways: list[dict[str, Any]] = [{"frame": "exit", "output_order": order} for order in orders]
        if len(self.scene.geometry().gloss) == 1:
            ways += [{"frame": "exit", "factors": factors} for factors in _FACTORS]
            ways += [{"frame": "visibility", "visibility_order": order} for order in sorted({4, 6, self.probe.order})]
        return ways

    def _enough(self, recipe: Recipe, error: float) -> Recipe | None:
        """The recipe with the fewest bounces and then rays that keep to the error; None if none do."""
        flat = recipe.replace(shadows=False)
        if self._keeps(flat, error):
            return flat
        counts = [0] if recipe.frame == "visibility" else self.probe.bounce_counts
        # The most rays tell first whether bands and bounces can do it at all.
        enough = next((b for b in counts if self._keeps(recipe.replace(bounces=b, rays=RAYS[-1]), error)), None)
        if enough is None:
            return None
        return next(
            made for rays in RAYS for made in [recipe.replace(bounces=enough, rays=rays)] if self._keeps(made, error)
        )

    def _keeps(self, recipe: Recipe, error: float) -> bool:
        bound = self.probe.error(recipe).bound
        self.nearest = min(self.nearest, bound)
        return bound <= error

    def _numbers(self, recipe: Recipe) -> tuple[int, int]:
        """What it stores of a receiver, in bytes about, and rays: to choose which to time."""
        channels = self.scene.requires(recipe.bounces).channels
        if recipe.frame == "visibility":
            rows, columns = 1, recipe.visibility_order or recipe.order
            numbers = rows * columns**2
        else:
            rows = recipe.factors or (recipe.output_order or 1) ** 2
            numbers = rows * recipe.order**2
        return channels * numbers * (4 if recipe.dtype == "float32" else 2), recipe.rays

    def _price(self, recipes: list[Recipe]) -> None:
        new = [recipe for recipe in recipes if recipe not in self._costs]
        if not new:
            return
        baked = {recipe: self._of_order(recipe) for recipe in new}
        eye = None if self.probe.eyes is None else self.probe.eyes[0]
        for recipe, (time, size) in frame_costs(baked, self.probe.receivers, self.probe.light[0], eye).items():
            self._costs[recipe] = 1e3 * time.median, size

    def _of_order(self, recipe: Recipe) -> Transfer:
        """Transfer of the sample of the very size that the recipe stores of a receiver."""
        return self.probe.sized(recipe, self.scene.requires(recipe.bounces).channels)


def _least(found: list[_Priced], least: Least) -> _Priced:
    best = min(getattr(each, least) for each in found)
    alike = [each for each in found if getattr(each, least) <= _ALIKE * best]
    others = [name for name in LEAST if name != least]
    return min(alike, key=lambda each: tuple(getattr(each, name) for name in ("bytes", *others)))


def _within(each: _Priced, milliseconds: float | None, bytes: int | None) -> bool:
    return (milliseconds is None or each.milliseconds <= milliseconds) and (bytes is None or each.bytes <= bytes)


def _told(probe: Probe, chosen: _Priced, error: float) -> Plan:
    predicted = {
        "error": chosen.error,
        "bound": chosen.bound,
        "milliseconds": chosen.milliseconds,
        "bytes": chosen.bytes,
        "seconds": chosen.seconds,
    }
    why = tuple(reasons(probe, chosen.recipe, error))
    return Plan(chosen.recipe, predicted, why, tuple(not_required(probe, chosen.recipe)))


def _impossible(
    probe: Probe,
    found: list[_Priced],
    error: float | None,
    milliseconds: float | None,
    bytes: int | None,
    search: _Search,
) -> str:
    if not found:
        return (
            f"error is {error or _ERRORS[-1]:.3g}, which no recipe that is sought among reaches: the nearest has "
            f"{search.nearest:.3g}, ask for that"
        )
    time = min(found, key=lambda each: each.milliseconds)
    size = min(found, key=lambda each: each.bytes)
    limits = {"milliseconds": milliseconds, "bytes": bytes}
    given = " and ".join(f"{name} {value:g}" for name, value in limits.items() if value is not None)
    wanted = f"an error of {error:.3g}" if error is not None else f"an error of {_ERRORS[-1]:g}"
    return (
        f"no recipe of {wanted} keeps to {given}: the fastest takes {time.milliseconds:.3g} ms and {time.bytes} bytes, "
        f"the smallest {size.milliseconds:.3g} ms and {size.bytes} bytes, ask for one of these or for a larger error"
    )


def _reference_output(scene: Scene, order: int, error: float) -> int:
    """Bands of exit radiance of the reference."""
    gloss = scene.geometry().gloss
    held = [each for each in _REFERENCE_OUTPUT if max(exit_error(brdf, each, order) for brdf in gloss) <= error / 4]
    return held[0] if held else _REFERENCE_OUTPUT[-1]


def eyes_around(scene: Scene) -> Float[Tensor, "E 3"]:
    """Eyes around the scene, at the distance of the pictures of it."""
    positions = scene.geometry().receiver_positions
    orbit = Orbit.around(positions, sides=EYES)
    turns = [2 * math.pi * side / EYES for side in range(EYES)]
    return torch.tensor([orbit.turned(turn, 0.0).camera().eye for turn in turns], dtype=torch.float64)


def _check(error: float | None, milliseconds: float | None, bytes: int | None, least: str) -> None:
    for name, value in (("error", error), ("milliseconds", milliseconds), ("bytes", bytes)):
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{name} is {value}: give a number above 0")
    if least not in LEAST:
        raise InputError(f"least is {least!r}: give {', '.join(LEAST[:-1])} or {LEAST[-1]}")
