"""Which of the measured points nobody beats, and what is lost where the cost is halved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from torchprt.measure.recipe import Recipe
from torchprt.measure.time import Timing

Cost = Literal["seconds", "bytes"]
COSTS: tuple[Cost, ...] = ("seconds", "bytes")
WORDS = {"seconds": "time", "bytes": "bytes"}
# Errors that differ by less, relative, are the same: a rounding more is no worse.
SAME = 0.01


@dataclass(frozen=True)
class Point:
    """A recipe and what was measured of it.

    - `error`: that of the light it serves worst, see `error_under`; `errors` of each light by name.
    - `psnr` in decibels, at most 100, and mean `flip` of the worst picture; see `Views.compare`.
    - `timing` of a frame of one light, CPU time of one thread; `bytes` of what is stored.
    - `bake_seconds`: CPU time of a bake of this recipe alone, all threads added up, None if a bake was given; `baked`
      says how that is known: "timed", "interpolated" or "given". `store_seconds`: of clustering or fitting.
    """

    recipe: Recipe
    error: float
    psnr: float
    flip: float
    timing: Timing
    bytes: int
    bake_seconds: float | None = None
    baked: str = "timed"
    store_seconds: float = 0.0
    errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """Of a frame, the median."""
        return self.timing.median

    def cost(self, by: Cost) -> float:
        """Seconds of a frame, or bytes."""
        return self.seconds if by == "seconds" else float(self.bytes)


def front(points: Sequence[Point], by: Cost) -> list[Point]:
    """The points that no other beats in error and cost, the cheapest first, so that error falls from each to the next.

    It falls by 1 % of itself at least: of points that differ by less the cheapest stands, and of points of one cost too
    the first of `points`.
    """
    found: list[Point] = []
    for point in sorted(points, key=lambda each: (each.cost(by), each.error)):
        if not found or point.error < (1 - SAME) * found[-1].error:
            found.append(point)
    return found


def fronts(points: Sequence[Point]) -> list[Point]:
    """The points on the front of time, of bytes, or both, the least error first."""
    on = {point.recipe: point for by in COSTS for point in front(points, by)}
    return sorted(on.values(), key=lambda each: (each.error, each.seconds))


@dataclass(frozen=True)
class Halved:
    """The best `point` for 1/`times` of what `start` costs; None if there is none so cheap."""

    start: Point
    by: Cost
    times: int
    point: Point | None

    def __str__(self) -> str:
        """In words: "half the time: error 1.3 % -> 1.5 %, with order 4, onnx"."""
        share = {2: "half", 4: "a quarter of", 8: "an eighth of"}.get(self.times, f"1/{self.times} of")
        if self.point is None:
            return f"{share} the {WORDS[self.by]}: nothing that was tried is so cheap"
        before, after = percent(self.start.error), percent(self.point.error)
        said = f"{before} -> {after}"
        if self.point.error <= (1 + SAME) * self.start.error:
            said = f"{said} (nothing lost)"
        return f"{share} the {WORDS[self.by]}: error {said}, with {apart(self.point.recipe, self.start.recipe)}"


def halved(points: Sequence[Point], start: Point, by: Cost, times: int = 2) -> Halved:
    """What is lost if a frame may take 1/`times` of the time of `start`, or its model so many of the bytes."""
    cheap = [point for point in points if point.cost(by) <= start.cost(by) / times]
    line = front(cheap, by)
    return Halved(start, by, times, line[-1] if line else None)


def apart(recipe: Recipe, base: Recipe) -> str:
    """In what a recipe differs from the base: "order 4, onnx"; "all as in the base" if in nothing."""
    known = base.name.split(", ")
    words = [word for word in recipe.name.split(", ") if word not in known]
    if recipe.shadows and base.bounces > recipe.bounces == 0 and recipe.frame != "visibility":
        words.append("0 bounces")
    words += [f"no {word}" for word in (base.window, base.runtime) if word in known and word not in recipe.name]
    return ", ".join(words) or "all as in the base"


def percent(error: float) -> str:
    """An error as it is read: "1.3 %", "0.042 %"."""
    return f"{100 * error:.2g} %" if error < 0.995 else f"{100 * error:.0f} %"


def amount(by: Cost, cost: float | int) -> str:
    """A cost in the unit it is read in: "0.41 ms", "870 kB"."""
    if by == "seconds":
        return f"{1e3 * cost:.3g} ms"
    unit, name = next(((unit, name) for unit, name in ((2**20, "MB"), (2**10, "kB")) if cost >= unit), (1, "B"))
    return f"{cost / unit:.3g} {name}"
