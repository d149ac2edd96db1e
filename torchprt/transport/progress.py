"""A bar with the ray rate and the time left."""

from __future__ import annotations

import contextlib
import sys
from types import TracebackType
from typing import Any, TextIO, cast

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from torchprt.progress import quiet


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


class Bar:
    """A progress bar on standard error, one line a stage, none if TORCHPRT_QUIET is set; a context manager.

    `rates`: whether it says how much is done a second.
    """

    def __init__(self, rates: bool = True) -> None:
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

    def __enter__(self) -> Bar:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None):
        # rich ends even a bar that never began with an empty line.
        if self._task is not None:
            self._progress.stop()

    def start(self, stage: str, total: int, done: int = 0) -> None:
        self._progress.start()
        self._task = self._progress.add_task(stage, total=total, completed=done)

    def advance(self, count: int) -> None:
        if self._task is not None:
            self._progress.advance(self._task, count)
