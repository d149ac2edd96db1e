"""Frames timed side by side, a few at a time, and kept."""

from __future__ import annotations

import platform
import statistics
from collections.abc import Callable, Mapping
from typing import Any

import torch

from torchprt.measure.keep import Kept, key_of
from torchprt.measure.recipe import Recipe
from torchprt.measure.time import Timing, time_it

ROUNDS = 9
# Of frames that are timed side by side: how many, and how many bytes their models may take together.
TOGETHER, MOST_BYTES = 12, 1 << 30


class SideBySide:
    """Times of frames, each beside one of the `base`: what slows the machine slows that as well.

    `shapes` of a recipe: what the time of its frame depends on apart from how it is stored and run. What values are
    stored does not matter, so that recipes of the same shapes share a time. Kept for this machine and this torch.
    """

    def __init__(self, kept: Kept, base: Recipe, shapes: Callable[[Recipe], Mapping[str, Any]]):
        self._kept, self._base, self._shapes = kept, base, shapes

    def known(self, recipe: Recipe) -> bool:
        return self._kept.record(self.key(recipe)) is not None

    def key(self, recipe: Recipe) -> str:
        """The same for recipes whose frames take the same time."""
        sizes = {
            name: value for name, value in recipe.part("bake").items() if name not in ("rays", "bounces", "shadows")
        }
        return key_of(
            "time",
            shapes=[*self._shapes(recipe).items()],
            beside=[*self._shapes(self._base).items(), *self._base.part("bake", "store", "run").items()],
            machine=[platform.node(), platform.machine(), torch.__version__],
            **sizes,
            **recipe.part("store", "run"),
        )

    def time(self, frames: Mapping[Recipe, Callable[[], Any]], base: Callable[[], Any]) -> None:
        """Times these and keeps it. Limit torch to one thread first."""
        calls = {self.key(recipe): frame for recipe, frame in frames.items()}
        found = time_it({**calls, "base": base}, rounds=ROUNDS)
        beside = found.pop("base").median
        for key, timing in found.items():
            self._kept.keep(key, {**vars(timing), "base": beside})

    def timings(self, recipes: list[Recipe]) -> list[Timing]:
        """Of recipes that are known. All are in the time that the base took in the middle of its runs."""
        records = [self._kept.record(self.key(recipe)) or {} for recipe in recipes]
        base = statistics.median(record["base"] for record in records)
        found = []
        for record in records:
            scale = base / record["base"]
            median, best = record["median"] * scale, record["best"] * scale
            found.append(Timing(median, record["spread"], best, record["rounds"]))
        return found
