"""A stage of a bake: tasks are handed out, results come back, some are kept, and progress is told."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from torchprt.progress import Report
from torchprt.transport.tables import InMemory, Tables
from torchprt.transport.task import Results, Runner, T, Task


@dataclass(frozen=True)
class Stages:
    """Who runs the tasks of a bake, who is told of them, where results wait, if anywhere, and where they are put
    together."""

    runner: Runner
    report: Report
    store: Results | None = None
    tables: Tables = field(default_factory=InMemory)

    def run(
        self, stage: str, tasks: Sequence[T], *shared: object, first: int | None = None
    ) -> Iterator[tuple[T, dict[str, Tensor]]]:
        """The tensors of all tasks, as they come.

        With `first` results are kept in the store, if there is one, numbered from there; those that it holds already
        come at once, and are not computed.
        """
        missing: list[Task] = []
        done = 0
        for number, task in enumerate(tasks, first or 0):
            if first is None or self.store is None:
                missing.append(task)
            elif (found := self.store.load(number)) is None:
                missing.append(Kept(task.rows, task, number, self.store))
            else:
                done += task.work
                yield task, found
        self.report.start(stage, sum(task.work for task in tasks), done)
        with contextlib.closing(self.runner.map(missing, *shared)) as results:
            for ended, tensors in results:
                yield ended.task if isinstance(ended, Kept) else ended, tensors
                self.report.advance(ended.work)


@dataclass(frozen=True)
class Kept(Task):
    """A task whose results are kept by whoever runs it, also if nobody collects them any more."""

    task: Any
    number: int
    store: Results

    def compute(self, *shared: Any) -> dict[str, Tensor]:
        tensors = self.task(*shared)
        self.store.save(self.number, tensors)
        return {name: tensor for name, tensor in tensors.items() if name not in self.task.for_later}

    @property
    def work(self) -> int:
        return self.task.work
