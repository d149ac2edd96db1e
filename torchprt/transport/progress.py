"""A bar with the ray rate and the time left."""

from __future__ import annotations

import contextlib
import sys
from types import TracebackType
from typing import Any, TextIO, cast

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from torchprt.progress import in_lines, quiet

# Stages that count rays.
TRACING = ("trace", "points")


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        if speed is None:
            return Text("")
        return Text(rate(speed), style="progress.data.speed")


def rate(speed: float) -> str:
    """So many a second: millions of rays, thousands of receivers, or a few large pieces of work."""
    unit, name = next(((unit, name) for unit, name in ((1e6, "M/s"), (1e3, "k/s")) if speed >= unit), (1.0, "/s"))
    return f"{speed / unit:.{0 if speed >= 10 * unit else 1}f} {name}"


class _Unheard:
    """A stream whose faults stop nobody: a terminal may be closed, or a log without room, while work goes on."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Lines:
    """The stage and its per cent, a line whenever that has changed: what programs can read without a terminal."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._stage, self._total, self._done, self._told = "", 0, 0, -1

    def start(self, stage: str, total: int, done: int = 0) -> None:
        self._stage, self._total, self._done, self._told = stage, total, 0, -1
        self.advance(done)

    def advance(self, count: int) -> None:
        self._done += count
        share = 100 if self._total <= 0 else min(100 * self._done // self._total, 100)
        if share > self._told:
            self._told = share
            self._stream.write(f"{self._stage} {share}%\n")
            self._stream.flush()


class Bar:
    """A progress bar on standard error, one line a stage, none if TORCHPRT_QUIET is set; a context manager.

    With TORCHPRT_PROGRESS=lines there is a line for each per cent of a stage instead, `diffuse 37%`.
    `rates`: whether it says how much is done a second. `engine`: who traces, said of the stages that do.
    """

    def __init__(self, rates: bool = True, engine: str | None = None) -> None:
        self._engine = engine
        columns: list[ProgressColumn] = [
            TextColumn("{task.description:>9}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f}%"),
        ]
        columns += [_Rate()] if rates else []
        stream = cast(TextIO, _Unheard(sys.stderr)) if sys.stderr else None
        console = Console(file=stream, stderr=True, quiet=quiet())
        self._progress = Progress(*columns, TimeRemainingColumn(), console=console)
        self._task: TaskID | None = None
        self._lines = _Lines(stream) if stream is not None and in_lines() and not quiet() else None

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None):
        # rich ends even a bar that never began with an empty line.
        if self._task is not None:
            self._progress.stop()

    def start(self, stage: str, total: int, done: int = 0) -> None:
        if self._lines is not None:
            self._lines.start(stage, total, done)
            return
        self._progress.start()
        told = f"{stage} by {self._engine}" if self._engine and stage in TRACING else stage
        self._task = self._progress.add_task(told, total=total, completed=done)

    def advance(self, count: int) -> None:
        if self._lines is not None:
            self._lines.advance(count)
        elif self._task is not None:
            self._progress.advance(self._task, count)
