"""Many works of different length told as one stage."""

from __future__ import annotations

from types import TracebackType

from torchprt.progress import Report

# Of a second.
UNIT = 0.1
# Of what is left of a step: taken for its next stage, since nobody says how many follow.
_STAGE = 0.6


class Whole:
    """Tells steps, each expected to take some seconds, as one stage `name` of `seconds`.

    The unit is a tenth of an expected second, so that a rate of 10 a second says that all goes as expected. It is full
    when `end` is called, and never before. When it becomes known what follows, `expect` tells.
    """

    def __init__(self, report: Report, name: str, seconds: float):
        self._report, self._total = report, max(1, round(seconds / UNIT))
        self._place, self._told, self._scale = 0.0, 0, 1.0
        report.start(name, self._total)

    def step(self, seconds: float) -> Step:
        """A context manager for the next step; it is a report for the stages of its work."""
        return Step(self, self._scale * seconds / UNIT)

    def expect(self, seconds: float) -> None:
        """The steps that follow take so many seconds, and fill what is left."""
        self._scale = (self._total - self._place) * UNIT / max(seconds, UNIT)

    def move(self, amount: float) -> None:
        self._place += amount
        self._tell(min(int(self._place), self._total - 1))

    def end(self) -> None:
        """All is done."""
        self._tell(self._total)

    def _tell(self, place: int) -> None:
        if place > self._told:
            self._report.advance(place - self._told)
            self._told = place


class Step:
    """A part of a whole: a report whose stages fill it, and that is full when it is left."""

    def __init__(self, whole: Whole, units: float):
        self._whole, self._left = whole, units
        self._stage, self._work, self._done = 0.0, 1, 0

    def __enter__(self) -> Step:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None):
        if kind is None:
            self._move(self._left)

    def start(self, stage: str, total: int, done: int = 0) -> None:
        self._stage, self._work, self._done = self._left * _STAGE, max(1, total), 0
        self.advance(done)

    def advance(self, count: int) -> None:
        count = min(count, self._work - self._done)
        self._done += count
        self._move(self._stage * count / self._work)

    def _move(self, units: float) -> None:
        units = min(units, self._left)
        self._left -= units
        self._whole.move(units)
