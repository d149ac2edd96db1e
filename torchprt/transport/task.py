"""A piece of a bake as a value, and the seam between what is computed and who computes it."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Hashable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar, runtime_checkable

import torch
from torch import Tensor

# Receivers a chunk: what a crash loses, what a worker holds, and how long the others wait for the last one. Part of
# the bits of the result, so not a parameter.
CHUNK = 512


def chunks(count: int) -> list[slice]:
    """Rows 0 to `count` in slices of at most `CHUNK`."""
    return [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]


@dataclass(frozen=True)
class Task(ABC):
    """A piece of a bake: plain values that say what to compute of which receivers, a few hundred bytes when pickled.

    `rows` of the receivers: neighbours, or one by one. Called with what all tasks of a stage share, a task returns
    contiguous tensors by name. Laws: the same bits in any thread or process, as long as torch is on one thread there
    (a product that is split otherwise rounds otherwise); nothing that it is given changes.
    """

    rows: slice | tuple[int, ...]
    # Results that only later tasks need, from the store: they are not handed to whoever collects.
    for_later: ClassVar[tuple[str, ...]] = ()

    def __call__(self, *shared: Any) -> dict[str, Tensor]:
        return {name: tensor.contiguous() for name, tensor in self.compute(*shared).items()}

    @abstractmethod
    def compute(self, *shared: Any, **_: Any) -> dict[str, Tensor]:
        """The tensors, of any strides."""

    @property
    def index(self) -> slice | Tensor:
        """The rows as tensors take them."""
        return self.rows if isinstance(self.rows, slice) else torch.tensor(self.rows)

    @property
    def count(self) -> int:
        """How many receivers."""
        return self.rows.stop - self.rows.start if isinstance(self.rows, slice) else len(self.rows)

    @property
    def work(self) -> int:
        """What progress counts: rays where they are traced, else receivers."""
        return self.count


T = TypeVar("T", bound=Task)
R = TypeVar("R")


@runtime_checkable
class Runner(Protocol):
    """Who runs tasks: threads, processes, or a cluster that does the same."""

    def map(self, tasks: Iterable[T], *shared: object) -> Generator[tuple[T, dict[str, Tensor]], None, None]:
        """Every task with its `task(*shared)`, as they come.

        What is `shared` pickles. It is sent once to each worker, and not again by the next call if it is the same
        object. Few results may wait for the consumer. When that stops or is interrupted (the generator is closed),
        what runs is finished and the rest is dropped.
        """


@runtime_checkable
class Results(Protocol):
    """Where results wait, by the number of their chunk. Pickles as the name of a place where workers read and write."""

    def save(self, number: int, tensors: dict[str, Tensor]) -> None:
        """Keeps the tensors, whole or not at all."""

    def load(self, number: int) -> dict[str, Tensor] | None:
        """The tensors, or None if they are not there or damaged."""

    def read(self, number: int) -> dict[str, Tensor]:
        """The tensors of a chunk that was saved before. Raises InputError if it is not there any more."""


class Once:
    """What a worker makes once for all tasks that need the same, and holds until they need something else. It is not
    sent: pickled, it is empty."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._key: Hashable = None
        self._made: Any = None

    def __call__(self, key: Hashable, make: Callable[[], R]) -> R:
        # One thread makes it while the others wait, and nothing else is held meanwhile: it may be large.
        with self._lock:
            if key != self._key:
                self._key = self._made = None
                self._made = make()
                self._key = key
            return self._made

    def forget(self) -> None:
        """Makes room."""
        with self._lock:
            self._key = self._made = None

    def __reduce__(self) -> tuple[type[Once], tuple[()]]:
        return Once, ()
