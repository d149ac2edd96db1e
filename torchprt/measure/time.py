"""Timing that a shared machine disturbs as little as possible."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from torchprt.errors import InputError


@dataclass(frozen=True)
class Timing:
    """Seconds of process CPU time for one call, over `rounds` interleaved rounds.

    `spread`: half the range between the quartiles, relative to the median.
    """

    median: float
    spread: float
    best: float
    rounds: int

    def __str__(self) -> str:
        return f"{self.median:.3e} s ± {100 * self.spread:.0f} %"


def time_it(functions: Mapping[str, Callable[[], Any]], *, rounds: int = 9, seconds: float = 0.02) -> dict[str, Timing]:
    """Times the functions side by side: every round runs each of them for about `seconds`, one after another.

    Interleaving makes what slows the machine down slow all of them, so that ratios hold; process CPU time leaves
    out what other processes take. Limit torch to one thread first: CPU time adds up the threads. Each function is
    called once before, untimed.

    Raises InputError without functions or with less than one round.
    """
    if not functions:
        raise InputError("there are no functions to time: give at least one")
    if rounds < 1:
        raise InputError(f"rounds must be at least 1, not {rounds}")
    calls = {}
    for name, function in functions.items():
        function()
        once = _measure(function, 1)
        calls[name] = max(1, round(seconds / max(once, 1e-9)))
    found: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            found[name].append(_measure(function, calls[name]))
    return {name: _timing(values) for name, values in found.items()}


def _measure(function: Callable[[], Any], calls: int) -> float:
    start = time.process_time()
    for _ in range(calls):
        function()
    return (time.process_time() - start) / calls


def _timing(values: list[float]) -> Timing:
    median = statistics.median(values)
    low, _, high = statistics.quantiles(values, n=4) if len(values) > 1 else (median, median, median)
    return Timing(median, (high - low) / 2 / median if median else 0.0, min(values), len(values))
