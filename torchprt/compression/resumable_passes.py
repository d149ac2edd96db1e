"""Passes over all points, one after another: told to a report, and kept so that a stopped work goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from torchprt.compression.checkpoint import Checkpoint
from torchprt.progress import Report, Silent


class Stage:
    """Passes over `points`, each a function of what the one before it left.

    `done` of them are, and left what is `kept`: tensors by name, none at the beginning.
    """

    def __init__(self, name: str, planned: int, points: int, report: Report, store: Checkpoint):
        self.kept = store.get(name)
        self.done = int(self.kept.pop("done", 0))
        self._name, self._planned, self._points, self._report, self._store = name, planned, points, report, store
        self._total = max(planned, self.done) * points
        self._told = self.done * points
        if self._total:
            report.start(name.rsplit("/", 1)[-1], self._total, self._told)

    def advance(self, points: int) -> None:
        """So many points of a pass are done."""
        if points and self._told == self._total:
            # More passes than were planned.
            self._total += self._points
            self._report.start(self._name.rsplit("/", 1)[-1], self._points)
        self._told += points
        if points:
            self._report.advance(points)

    def keep(self, tensors: dict[str, Tensor], *, passes: int = 1, last: bool = False) -> None:
        """So many more passes are done, and left `tensors`; `last`: none of those that were planned is to follow."""
        self.done = max(self._planned, self.done + passes) if last else self.done + passes
        self._store.put(self._name, {"done": torch.tensor(self.done, device="cpu")} | tensors)
        self.reach(self.done)

    def reach(self, passes: int) -> None:
        """Tells of what passes took less than all points for."""
        self.advance(max(0, passes * self._points - self._told))

    def end(self) -> None:
        """Tells the report that this is all."""
        self.advance(self._total - self._told)


@dataclass(frozen=True)
class Passes:
    """Where the passes of a clustered PCA are told, kept under names that start with `name`, and done by `threads`."""

    report: Report = field(default_factory=Silent)
    store: Checkpoint = field(default_factory=Checkpoint)
    name: str = ""
    threads: int = field(default_factory=torch.get_num_threads)

    @contextmanager
    def stage(self, name: str, planned: int, points: int) -> Iterator[Stage]:
        """A stage that goes on from what is kept of it; its name is what the report shows."""
        stage = Stage(self.name + name, planned, points, self.report, self.store)
        yield stage
        stage.end()

    def named(self, name: str) -> Passes:
        """The same, for one of several works that are kept in one file."""
        return replace(self, name=f"{self.name}{name}/")

    def within(self, stage: Stage) -> Passes:
        """Passes that count as those of `stage` and are not kept themselves."""
        return Passes(_Within(stage), threads=self.threads)

    def result(self) -> dict[str, Tensor]:
        """What `finish` kept; nothing before."""
        return self.store.get(f"{self.name}result")

    def finish(self, **tensors: Tensor) -> None:
        """Keeps a result instead of the stages that led to it."""
        self.store.drop(self.name)
        self.store.put(f"{self.name}result", tensors)


class _Within:
    def __init__(self, stage: Stage):
        self._stage = stage

    def start(self, stage: str, total: int, done: int = 0) -> None: ...

    def advance(self, count: int) -> None:
        self._stage.advance(count)
