"""Threads over chunks: the same bits however many there are."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from typing import TypeVar

import torch

# Receivers a chunk: what a crash loses, what a thread holds, and how long the others wait for the last one. Part of
# the bits of the result, so not a parameter.
CHUNK = 512

R = TypeVar("R")


def chunks(count: int) -> list[slice]:
    """Rows 0 to `count` in slices of at most `CHUNK`."""
    return [slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK)]


class Workers:
    """A pool of threads, each with torch on one thread: the bits of a product depend on how it is split."""

    def __init__(self, threads: int):
        self.threads = threads

    def __enter__(self) -> Workers:
        self._torch_threads = torch.get_num_threads()
        torch.set_num_threads(1)
        self._pool = ThreadPoolExecutor(self.threads, thread_name_prefix="bake")
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)
        torch.set_num_threads(self._torch_threads)

    def map(self, function: Callable[..., R], items: Sequence) -> Iterator[R]:
        """Results as they come. When the consumer stops (Ctrl-C), what runs is finished and the rest is dropped."""
        pending: set[Future[R]] = set()
        waiting = iter(items)
        try:
            while True:
                # Few in flight: their results must not pile up behind a slow consumer.
                while len(pending) < 2 * self.threads and (item := next(waiting, None)) is not None:
                    pending.add(self._pool.submit(function, item))
                if not pending:
                    return
                finished, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield future.result()
        finally:
            for future in pending:
                future.cancel()
            wait(pending)
