"""Who runs the tasks of a bake on this machine: threads, or processes."""

from __future__ import annotations

import contextlib
import functools
import itertools
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from typing import TypeVar

import safetensors.torch
import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import no_temporary, temporary_folder
from torchprt.transport.held import Held
from torchprt.transport.task import R, T, Task

P = TypeVar("P", bound="_Pool")


@contextlib.contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """The bits of a product depend on how it is split.

    A process that has used several threads of OpenMP cannot be forked and then use several again, so a bake uses none.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


class _Pool:
    """A number of workers; a context manager that ends them, after what runs."""

    def __init__(self, count: int, pool: Executor):
        self.count = count
        self._pool = pool

    def __enter__(self: P) -> P:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)


class Threads(_Pool):
    """`count` threads of this process. They are enough for Embree: embreex releases the GIL."""

    def __init__(self, count: int):
        # The number of threads is one of each thread: what a bake sets does not reach those that are started in it.
        one = functools.partial(torch.set_num_threads, 1)
        super().__init__(count, ThreadPoolExecutor(count, thread_name_prefix="bake", initializer=one))

    def map(self, tasks: Iterable[T], *shared: object) -> Generator[tuple[T, dict[str, Tensor]], None, None]:
        """As `Runner.map`."""
        # Few in flight: their results must not pile up behind a slow consumer.
        return _as_they_come(lambda task: self._pool.submit(task, *shared), tasks, 2 * self.count)


class Processes(_Pool):
    """`count` processes, started afresh ("spawn"), each with torch on one thread; for one bake at a time.

        with Processes(4) as processes:
            transfer = bake(scene, runner=processes)

    The same bits as threads. Each process holds what tasks share (the scene and its receivers; with bounces the exit
    radiance) and builds Embree's tree for itself; what is shared travels through files in the system's temporary
    folder. A script needs the usual `if __name__ == "__main__":`, because a new process imports it. Ctrl-C lets them
    finish what they have and at most one more task; they end when this process does.

    Raises InputError if something of the scene cannot be pickled (a `brdf.Measured` of a local function), and
    concurrent.futures.process.BrokenProcessPool if a process is killed: what a checkpoint keeps stays.
    """

    def __init__(self, count: int):
        super().__init__(count, ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _start))
        self._folder = temporary_folder()
        self._held: Held[Path] = Held()
        self._number = itertools.count()

    def __exit__(self, *fault: object) -> None:
        super().__exit__(*fault)
        self._held.forget()
        self._folder.cleanup()

    def map(self, tasks: Iterable[T], *shared: object) -> Generator[tuple[T, dict[str, Tensor]], None, None]:
        """As `Runner.map`."""
        for path in self._held.gone():
            path.unlink()
        paths = [self._held.of(thing, self._write) for thing in shared]
        held = frozenset(self._held.all)
        running = _as_they_come(lambda task: self._pool.submit(_run, task, paths, held), tasks, self.count + 1)
        with contextlib.closing(running):
            for task, packed in running:
                yield task, safetensors.torch.load(packed)

    def _write(self, thing: object) -> Path:
        path = Path(self._folder.name) / f"{next(self._number)}.pickle"
        try:
            with path.open("wb") as file:
                pickle.dump(thing, file, pickle.HIGHEST_PROTOCOL)
        except OSError as fault:
            raise no_temporary(str(fault.strerror)) from fault
        except (pickle.PicklingError, AttributeError, TypeError) as fault:
            raise InputError(f"the scene cannot be sent to other processes ({fault}): bake with threads") from fault
        return path


def _as_they_come(
    submit: Callable[[T], Future[R]], tasks: Iterable[T], most: int
) -> Generator[tuple[T, R], None, None]:
    """Tasks with their results, `most` of them in flight. Closed early, it waits for what runs and drops the rest."""
    pending: dict[Future[R], T] = {}
    waiting = iter(tasks)
    try:
        while True:
            while len(pending) < most and (task := next(waiting, None)) is not None:
                pending[submit(task)] = task
            if not pending:
                return
            finished, _ = wait(pending, return_when=FIRST_COMPLETED)
            for future in finished:
                yield pending.pop(future), future.result()
    finally:
        for future in pending:
            future.cancel()
        wait(pending)


def _start() -> None:
    """What a process does first."""
    # Ctrl-C reaches the whole group; who collects decides when to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)


_held: dict[Path, object] = {}


def _run(task: Task, paths: list[Path], held: frozenset[Path]) -> bytes:
    """In a process: the tensors of a task as bytes; what is shared is read when it first comes."""
    for path in _held.keys() - held:
        del _held[path]
    for path in paths:
        if path not in _held:
            with path.open("rb") as file:
                _held[path] = pickle.load(file)
    return safetensors.torch.save(task(*(_held[path] for path in paths)))
