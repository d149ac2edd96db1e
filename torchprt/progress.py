"""What long work tells while it runs."""

from __future__ import annotations

import os
from typing import Protocol, runtime_checkable

QUIET = "TORCHPRT_QUIET"
PROGRESS = "TORCHPRT_PROGRESS"


def quiet() -> bool:
    """Whether nothing is to be told but faults: the environment variable TORCHPRT_QUIET is set, and not to 0."""
    return os.environ.get(QUIET, "") not in ("", "0")


def in_lines() -> bool:
    """Whether programs listen: the environment variable TORCHPRT_PROGRESS is `lines`.

    Bars are then lines on standard error, `diffuse 37%`, one for each per cent.
    """
    return os.environ.get(PROGRESS, "") == "lines"


@runtime_checkable
class Report(Protocol):
    """What listens to long work: a bar, or whatever has these two methods."""

    def start(self, stage: str, total: int, done: int = 0) -> None:
        """A stage begins: `total` rays (receivers for a bounce, points for compression), `done` were there already."""

    def advance(self, count: int) -> None:
        """`count` more are done."""


class Parts:
    """Several works of one size, one after the other, told as one: the bar of a work of `count` parts."""

    def __init__(self, report: Report, count: int) -> None:
        self._report = report
        self._count = count
        self._started = False

    def start(self, stage: str, total: int, done: int = 0) -> None:
        if not self._started:
            self._report.start(stage, total * self._count, done)
            self._started = True

    def advance(self, count: int) -> None:
        self._report.advance(count)


class Silent:
    """Tells nothing."""

    def start(self, stage: str, total: int, done: int = 0) -> None: ...

    def advance(self, count: int) -> None: ...
