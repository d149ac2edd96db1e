"""One stage of a bake as queues: tasks go from the scheduler to threads and their results back to the client."""

from __future__ import annotations

import heapq
import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

# Tasks a thread that are in flight, as in `torchprt.transport.cluster`.
IN_FLIGHT = 2
# So many tasks a thread are followed one by one; more of them take as much longer as the middle of these did.
FOLLOWED, FEW = 16, 2000


@dataclass
class Station:
    """Something that serves what comes to it in that order, `servers` at a time, each for `seconds`."""

    name: str
    seconds: float
    servers: int = 1
    _free: list[float] = field(default_factory=list, repr=False)

    def serve(self, now: float) -> float:
        """When what comes now has been served."""
        if not self.seconds:
            return now
        start = now if len(self._free) < self.servers else max(now, heapq.heappop(self._free))
        heapq.heappush(self._free, start + self.seconds)
        return start + self.seconds


@dataclass
class Work:
    """The way of a task: stations `before` it is on a thread, those that its thread waits for (`reading`, then
    `seconds` of its own, then `writing`), and those `after`."""

    before: list[Station]
    reading: list[Station]
    seconds: float
    writing: list[Station]
    after: list[Station]

    @property
    def stations(self) -> list[Station]:
        return [*self.before, *self.reading, *self.writing, *self.after]


def makespan(tasks: int, threads: int, work: Work) -> float:
    """Seconds until the results of all tasks are there.

    Laws: without stations `ceil(tasks / threads) * work.seconds`; where a station is slower than all else `tasks` times
    its seconds, and the rest of one way.
    """
    followed = min(tasks, max(FOLLOWED * threads, FEW))
    # Whole rounds of all threads, so that the middle is of as many as there are.
    followed = followed if followed == tasks else followed // threads * threads
    ends = _ends(followed, threads, work)
    if followed == tasks:
        return ends[-1]
    rounds = followed // threads
    first, last = rounds // 4 * threads, 3 * rounds // 4 * threads
    rate = (ends[last] - ends[first]) / (last - first)
    left = tasks - followed
    # A round that is begun takes its whole time where threads are what is waited for, else its share.
    bound = rate * threads <= 1.0001 * _of_thread(work)
    return ends[-1] + (math.ceil(left / threads) * threads if bound else left) * rate


def _of_thread(work: Work) -> float:
    return work.seconds + sum(each.seconds for each in (*work.reading, *work.writing))


def _ends(tasks: int, threads: int, work: Work) -> list[float]:
    """When the result of each task is there, in order of time."""
    own: list[float | Station] = [*work.reading, work.seconds, *work.writing]
    steps: list[float | Station] = [*work.before, *own, *work.after]
    enters, leaves = len(work.before), len(work.before) + len(own)
    free, waiting, ends = threads, deque[int](), list[float]()
    given = min(tasks, IN_FLIGHT * threads)
    # The number of a task decides between those that come at the same time.
    events: list[tuple[float, int, int]] = [(0.0, task, 0) for task in range(given)]
    heapq.heapify(events)

    def go(now: float, task: int, step: int) -> None:
        each = steps[step] if step < len(steps) else None
        if isinstance(each, Station):
            now = each.serve(now)
        elif each is not None:
            now += each
        heapq.heappush(events, (now, task, step + 1))

    while events:
        now, task, step = heapq.heappop(events)
        if step == leaves:
            free += 1
            if waiting:
                free -= 1
                go(now, waiting.popleft(), enters)
        if step == enters:
            if not free:
                waiting.append(task)
                continue
            free -= 1
        if step < len(steps):
            go(now, task, step)
            continue
        ends.append(now)
        if given < tasks:
            heapq.heappush(events, (now, given, 0))
            given += 1
    return ends


def busy(tasks: int, stations: Iterable[Station]) -> dict[str, float]:
    """Seconds that each station serves so many tasks, all its servers side by side."""
    found: dict[str, float] = {}
    for each in stations:
        found[each.name] = found.get(each.name, 0.0) + tasks * each.seconds / each.servers
    return found
