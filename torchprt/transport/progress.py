"""A bar with the ray rate and the time left."""

from __future__ import annotations

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text


class _Rate(ProgressColumn):
    def render(self, task: Task) -> Text:
        speed = task.finished_speed or task.speed
        if speed is None:
            return Text("")
        # Millions of rays, thousands of receivers.
        text = f"{speed / 1e6:.1f} M/s" if speed >= 1e5 else f"{speed / 1e3:.1f} k/s"
        return Text(text, style="progress.data.speed")


class Bar:
    """A progress bar on standard error, one line a stage; a context manager."""

    def __init__(self) -> None:
        columns = (TextColumn("{task.description:>9}"), BarColumn(), TextColumn("{task.percentage:>3.0f}%"))
        self._progress = Progress(*columns, _Rate(), TimeRemainingColumn(), console=Console(stderr=True))
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
