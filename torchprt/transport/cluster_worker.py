"""What a worker of a cluster does: it holds what tasks share, runs them, and says what it is."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import functools
import importlib.metadata
import pickle
import signal
import threading
import time
from typing import Any

import safetensors.torch
import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transport.task import Results
from torchprt.transport.workers import torch_on_one_thread
from torchprt.version import VERSION

_SECONDS = "seconds"
# Of glibc's malloc.h, and the values that it comes to by itself.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


class Shared:
    """Something that the tasks of a stage share, pickled. It is made anew once, where a task first needs it: Embree's
    tree is built then, and what cannot be made is told by that task, since a connection can only break."""

    def __init__(self, packed: bytes):
        self._packed: bytes | None = packed
        self._thing: Any = None
        self._lock = threading.Lock()

    @property
    def thing(self) -> Any:
        """What was sent."""
        with self._lock:
            if self._packed is not None:
                self._thing = pickle.loads(self._packed)
                # Not held twice.
                self._packed = None
            return self._thing

    def __reduce__(self) -> tuple[type[Shared], tuple[pickle.PickleBuffer]]:
        # Workers hand it on to each other, most of them before they need it.
        with self._lock:
            packed = self._packed
            if packed is None:
                packed = pickle.dumps(self._thing, pickle.HIGHEST_PROTOCOL)
        return Shared, (pickle.PickleBuffer(packed),)


class _Busy:
    """How many tasks run in this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.count = 0

    def __enter__(self) -> None:
        with self._lock:
            self.count += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self.count -= 1


_busy = _Busy()


def run(wanted: dict[str, str], tasks: bytes, *shared: Shared) -> bytes:
    """What the pickled list of `tasks` gives, for `unpacked`, if this worker has the versions that are `wanted`."""
    differences = different(wanted, versions())
    if differences:
        from distributed import get_worker

        raise InputError(refused(get_worker().address, differences))
    _allocate_as_at_home()
    with _busy, torch_on_one_thread():
        things = [each.thing for each in shared]
        start = time.perf_counter()
        found = {
            f"{number}.{name}": tensor
            for number, task in enumerate(pickle.loads(tasks))
            for name, tensor in task(*things).items()
        }
        found[_SECONDS] = torch.tensor(time.perf_counter() - start, dtype=torch.float64)
        return safetensors.torch.save(found)


@functools.cache
def _allocate_as_at_home() -> None:
    """Dask has workers give all memory back that they free, and each task waits for the system to zero it again. What
    glibc does by itself keeps as much as a task uses."""
    with contextlib.suppress(OSError, AttributeError):
        mallopt = ctypes.CDLL(None).mallopt
        for name, value in ((_M_MMAP_THRESHOLD, 1 << 25), (_M_TRIM_THRESHOLD, 1 << 26)):
            mallopt(name, value)


def unpacked(packed: bytes, count: int) -> tuple[list[dict[str, Tensor]], float]:
    """The tensors of each of `count` tasks by name, and how many seconds they took together."""
    found = safetensors.torch.load(packed)
    seconds = float(found.pop(_SECONDS))
    results: list[dict[str, Tensor]] = [{} for _ in range(count)]
    for key, tensor in found.items():
        number, name = key.split(".", 1)
        results[int(number)][name] = tensor
    return results, seconds


async def finished() -> None:
    """Returns when no task runs here any more."""
    while _busy.count:
        await asyncio.sleep(0.02)


def sees(store: Results) -> str | None:
    """The fingerprint of a checkpoint as it is read from here."""
    return getattr(store, "fingerprint", None)


_versions: dict[str, str] = {}


def versions() -> dict[str, str]:
    """All that the bits of a result depend on beside its task."""
    if not _versions:
        _versions.update(torchprt=VERSION)
        _versions.update({name: importlib.metadata.version(name) for name in ("torch", "numpy", "embreex")})
        # Sums are added in another order with wider instructions.
        _versions["instructions of the processor"] = torch.backends.cpu.get_cpu_capability()
    return dict(_versions)


def different(wanted: dict[str, str], found: dict[str, str]) -> list[tuple[str, str, str]]:
    """What differs: its name, what is wanted and what was found."""
    return [(name, each, found.get(name, "none")) for name, each in wanted.items() if found.get(name) != each]


def refused(worker: str, differences: list[tuple[str, str, str]]) -> str:
    """The sentence of a worker that would give other bits."""
    said = ", ".join(f"{name} {found} where {wanted} is needed" for name, wanted, found in differences)
    advice = "install the same versions there"
    if any(name.startswith("instructions") for name, *_ in differences):
        advice = "choose machines of one kind, or set ATEN_CPU_CAPABILITY to the same on all of them and here"
    return f"the worker {worker} has {said}, which gives other results: {advice}"


def dask_setup(worker: Any) -> None:
    """Called by Dask when a worker of this machine starts."""
    # Ctrl-C reaches the whole group; who collects decides when to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
