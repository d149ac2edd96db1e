"""Who runs the tasks of a bake on other machines: the workers of a Dask cluster."""

from __future__ import annotations

import collections
import contextlib
import functools
import inspect
import itertools
import logging
import math
import pickle
import queue
import re
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from torch import Tensor

from torchprt.errors import InputError
from torchprt.transport import cluster_worker as worker
from torchprt.transport.cluster_worker import Shared
from torchprt.transport.held import Held
from torchprt.transport.stages import Kept
from torchprt.transport.task import Results, T

if TYPE_CHECKING:
    from distributed import Client, Future

# Seconds that a cluster may take to answer, and that a bake goes on without any worker.
ANSWER, ALONE = 10.0, 60.0
# Seconds of a worker, and bytes of results, that are sent and lost together. What is left is cut finer, so that all end
# at about the same time.
SPAN, BATCH_BYTES = 0.5, 1 << 24
# How often what all workers lost is sent again while no task ends.
_TRIES = 10
_GO_ON = "the same command goes on from what its checkpoint keeps"

P = ParamSpec("P")
R = TypeVar("R")


class Cluster:
    """The workers of a Dask `client`, for one bake at a time; a `Runner`.

        with distributed.Client("tcp://10.0.0.1:8786") as client:
            transfer = bake(scene, on=client, checkpoint="s3://bucket/bake")

    The same bits as threads. What tasks share is sent once to each worker, which holds it as long as it lives here and
    builds Embree's tree for itself. Tasks go out some at a time, as many as take `SPAN` seconds, because each that the
    scheduler knows costs it milliseconds; two such batches a thread of a worker are in flight. A worker that dies loses
    the batches that it has; others compute them.

    Raises InputError if the cluster has no workers, or one that has no torchprt or other versions of it, of torch,
    numpy or embreex, or other instructions of its processor, which round otherwise; in `map` if workers do not reach
    the store of the bake, if the scheduler or all workers go away, and if a chunk ends every worker that has it.
    """

    def __init__(self, client: Client):
        if client.asynchronous:
            raise InputError("the client of the cluster is asynchronous: give one that is not")
        self._client = client
        self._held: Held[Future] = Held()
        self._seen: Results | None = None
        self._wanted = worker.versions()
        self.check()

    @property
    def name(self) -> str:
        """The address of the scheduler."""
        return str(getattr(self._client.scheduler, "address", "of the client"))

    @property
    def threads(self) -> int:
        """Of all workers together, now."""
        return sum(self._client.nthreads().values())

    def check(self) -> None:
        """Raises InputError if there are no workers, or one of other versions."""
        try:
            self._client.wait_for_workers(1, timeout=ANSWER)
        except TimeoutError:
            raise InputError(
                f"the cluster {self.name} has no workers: start some, `dask worker {self.name} --nthreads 1`"
            ) from None
        for address, found in self._ask(worker.versions).items():
            if isinstance(found, Exception):
                raise InputError(
                    f"the worker {address} cannot run torchprt ({found}): install torchprt {self._wanted['torchprt']} "
                    "there"
                ) from found
            differences = worker.different(self._wanted, found)
            if differences:
                raise InputError(worker.refused(address, differences))

    def map(self, tasks: Iterable[T], *shared: object) -> Generator[tuple[T, dict[str, Tensor]], None, None]:
        """As `Runner.map`."""
        waiting = list(tasks)
        if not waiting:
            return
        stores = [each.store for each in waiting[:1] if isinstance(each, Kept)]
        with self._told(stores[0] if stores else None):
            for store in (*stores, *shared):
                if isinstance(store, Results):
                    self._check_store(store)
            with contextlib.closing(_Flight(self, waiting, shared).results()) as results:
                yield from results

    def send(self, shared: tuple[object, ...], anew: bool = False) -> list[Future]:
        """What is shared, at all workers; what lives here no more is forgotten there."""
        if anew:
            self._held.forget()
        self._held.gone()
        return [self._held.of(thing, self._scatter) for thing in shared]

    def wait(self) -> int:
        """The threads of all workers; waits if there are none, but not for ever: then it raises InputError."""
        end = time.monotonic() + ALONE
        while not (threads := self.threads):
            if not self.alive:
                raise CancelledError("closed")
            if time.monotonic() > end:
                raise InputError(f"all workers of the cluster {self.name} went away: start some again; {_GO_ON}")
            time.sleep(0.5)
        return threads

    def _scatter(self, thing: object) -> Future:
        try:
            # Here, and not in Dask, whose words are many.
            packed = pickle.dumps(thing, pickle.HIGHEST_PROTOCOL)
        except (pickle.PicklingError, AttributeError, TypeError) as fault:
            raise InputError(f"the scene cannot be sent to other machines ({fault}): bake with threads") from fault
        shared = Shared(packed)
        for tries in itertools.count(1):
            try:
                return self._client.scatter(shared, broadcast=True, hash=False)
            except (OSError, TimeoutError, KeyError):
                # A worker died meanwhile.
                if tries == _TRIES or not self.alive:
                    raise
                self.wait()
        raise AssertionError

    def _check_store(self, store: Results) -> None:
        """Raises InputError if a worker does not see the checkpoint that chunks go to."""
        if store is self._seen:
            return
        wanted = worker.sees(store)
        for address, found in self._ask(worker.sees, store).items():
            if isinstance(found, InputError):
                raise found
            if found != wanted:
                raise InputError(
                    f"the worker {address} does not see {store}, where chunks of the bake wait: name a checkpoint that "
                    "all workers reach, a folder that machines share or a URL, s3://..."
                )
        self._seen = store

    def _ask(self, function: Callable[..., Any], *arguments: object) -> dict[str, Any]:
        """What each worker answers, or the exception."""
        return self._client.run(function, *arguments, on_error="return")

    @contextlib.contextmanager
    def _told(self, store: Results | None) -> Iterator[None]:
        """What the cluster does is one sentence."""
        from distributed import KilledWorker
        from distributed.comm import CommClosedError

        keeps = _GO_ON if store is None else f"the same command goes on from {store}"
        try:
            yield
        except KilledWorker as fault:
            raise InputError(
                f"a chunk of the bake ended every worker of {self.name} that had it, perhaps for want of memory: give "
                f"them more, or fewer threads; {keeps}"
            ) from fault
        except (CancelledError, CommClosedError) as fault:
            raise InputError(f"the scheduler {self.name} went away: start it again; {keeps}") from fault
        except (OSError, RuntimeError) as fault:
            if self.alive:
                raise
            raise InputError(f"the scheduler {self.name} went away: start it again; {keeps}") from fault

    @property
    def alive(self) -> bool:
        """Whether the scheduler is there."""
        return self._client.status == "running"

    @property
    def client(self) -> Client:
        """That of Dask."""
        return self._client

    @property
    def wanted(self) -> dict[str, str]:
        """The versions that workers must have."""
        return self._wanted


class _Flight:
    """The tasks of one `map`, and the batches of them that workers have."""

    def __init__(self, cluster: Cluster, tasks: Sequence[Any], shared: tuple[object, ...]):
        self._cluster, self._tasks, self._shared = cluster, collections.deque(tasks), shared
        self._futures = cluster.send(shared)
        self._pending: dict[Future, list[Any]] = {}
        self._ended: queue.SimpleQueue[Future] = queue.SimpleQueue()
        self._threads, self._counted, self._lost = 0, 0.0, 0
        # Of what has ended: tasks, seconds of workers, bytes of results.
        self._done, self._seconds, self._bytes = 0, 0.0, 0

    def results(self) -> Generator[tuple[Any, dict[str, Tensor]], None, None]:
        """As `Runner.map`."""
        self._count()
        try:
            while True:
                # Few in flight: the next of each thread, whose results must not pile up behind a slow consumer.
                while self._tasks and len(self._pending) < 2 * self._threads:
                    self._submit([self._tasks.popleft() for _ in range(self._size())])
                if not self._pending:
                    return
                for future in self._next():
                    if future.status == "error":
                        raise future.exception()
                    packed = self._gathered(future)
                    tasks = self._pending.pop(future)
                    if packed is None:
                        self._again(tasks)
                        continue
                    self._lost = 0
                    future.release()
                    results, seconds = worker.unpacked(packed, len(tasks))
                    self._done, self._seconds = self._done + len(tasks), self._seconds + seconds
                    self._bytes += len(packed)
                    yield from zip(tasks, results, strict=True)
        finally:
            self._end()

    def _size(self) -> int:
        """Tasks of the next batch."""
        if not self._done:
            return 1
        fit = min(SPAN * self._done / max(self._seconds, 1e-9), BATCH_BYTES * self._done / max(self._bytes, 1))
        share = math.ceil(len(self._tasks) / (4 * self._threads))
        return max(1, min(int(fit), share, len(self._tasks)))

    def _submit(self, tasks: list[Any]) -> None:
        key = f"bake-{type(getattr(tasks[0], 'task', tasks[0])).__name__.lower()}-{uuid.uuid4().hex}"
        client, wanted = self._cluster.client, self._cluster.wanted
        future = client.submit(worker.run, wanted, pickle.dumps(tasks), *self._futures, key=key, pure=False)
        self._pending[future] = tasks
        future.add_done_callback(self._ended.put)

    def _next(self) -> list[Any]:
        """Futures that have ended, one at least."""
        while True:
            found: list[Future] = []
            with contextlib.suppress(queue.Empty):
                found.append(self._ended.get(timeout=1.0))
                while True:
                    found.append(self._ended.get_nowait())
            if time.monotonic() - self._counted > 2:
                self._count()
            found = [future for future in found if future in self._pending]
            if found:
                return found

    def _gathered(self, future: Future) -> bytes | None:
        """What tasks gave, or None if it was lost with what they need."""
        try:
            return future.result()
        except CancelledError:
            return None

    def _again(self, tasks: list[Any]) -> None:
        """Every worker that held what tasks share is gone."""
        self._lost += 1
        if not self._cluster.alive or self._lost > 2 * _TRIES * self._threads:
            raise CancelledError("lost")
        if any(future.status != "finished" for future in self._futures):
            self._futures = self._cluster.send(self._shared, anew=True)
        self._submit(tasks)

    def _count(self) -> None:
        self._threads, self._counted = self._cluster.wait(), time.monotonic()

    def _end(self) -> None:
        """Drops what waits, and lets what runs be finished and kept."""
        if not self._pending or not self._cluster.alive:
            return
        with contextlib.suppress(Exception):
            self._cluster.client.cancel(list(self._pending))
            self._cluster.client.run(worker.finished, on_error="ignore")


@contextlib.contextmanager
def connected(on: Client | Cluster | str) -> Iterator[Cluster]:
    """The cluster that the argument `on` of a bake names: a Dask client, the address of a scheduler, or "local:4", four
    processes of this machine that end with the block.

    Raises InputError if Dask is not installed, or there is no such cluster.
    """
    if isinstance(on, Cluster):
        yield on
        return
    try:
        import distributed
    except ImportError:
        raise InputError(
            "bakes on clusters need Dask, which is not installed: `pip install 'torchprt[cluster]'`"
        ) from None
    if isinstance(on, distributed.Client):
        yield Cluster(on)
        return
    if not isinstance(on, str):
        raise InputError(f"on is a {type(on).__name__}: give a client of Dask, the address of a scheduler, or local:4")
    if found := re.fullmatch(r"local:(.*)", on):
        if not re.fullmatch(r"[1-9]\d{0,3}", found[1]):
            raise InputError(f"the cluster '{on}' has no number of workers: say local:4")
        with _local(int(found[1])) as client:
            yield Cluster(client)
        return
    if not re.fullmatch(r"([a-z]+://)?[^/\s]+:\d+/?", on):
        raise InputError(
            f"the cluster '{on}' is no address: say tcp://HOST:PORT, or local:4 for workers of this machine"
        )
    with _hushed():
        try:
            client = distributed.Client(on, timeout=ANSWER, set_as_default=False)
        except (OSError, ValueError, RuntimeError) as fault:
            raise InputError(
                f"there is no cluster at {on}: start a scheduler there (`dask scheduler`), or say local:4 for workers "
                "of this machine"
            ) from fault
        with client:
            yield Cluster(client)


@contextlib.contextmanager
def _hushed() -> Iterator[None]:
    """Without what Dask writes of a scheduler that goes away, which `Cluster` says in one sentence."""
    # Dask gives both a level of their own.
    logs = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    before = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for log, level in zip(logs, before, strict=True):
            log.setLevel(level)


@contextlib.contextmanager
def _local(count: int) -> Iterator[Client]:
    """A client of so many processes of this machine, with a thread each."""
    import dask
    from distributed import Client, LocalCluster

    with (
        # It gives up what does not come back in so long, and loses what dies twice within it.
        dask.config.set({"distributed.deploy.lost-worker-timeout": "365 days"}),
        LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            # Not its usual port, where another cluster may be.
            dashboard_address="127.0.0.1:0",
            # Not spilled to disk, nor ended: it is the user's memory.
            memory_limit=0,
            # Workers that die are started again, and what they lost is sent again.
            silence_logs=logging.CRITICAL,
            preload=worker.__name__,
        ) as cluster,
        Client(cluster, set_as_default=False, direct_to_workers=True) as client,
    ):
        yield client


def on_clusters(function: Callable[P, R]) -> Callable[P, R]:
    """Makes a function of what it is `on` one of a `runner`: the one place where the two meet.

    Raises InputError if threads or a runner are given as well.
    """

    @functools.wraps(function)
    def bound(*arguments: P.args, **named: P.kwargs) -> R:
        on: Any = named.pop("on", None)
        if on is None:
            return function(*arguments, **named)
        for other in ("threads", "runner"):
            if named.get(other) is not None:
                raise InputError(f"on and {other} are both given: leave one of the two out")
        with connected(on) as runner:
            named["runner"] = runner
            return function(*arguments, **named)

    assert "on" in inspect.signature(function).parameters
    return bound
