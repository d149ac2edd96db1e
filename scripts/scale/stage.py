"""One stage of a bake as queues: batches of chunks go from the scheduler to threads, their results to the client."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

# Batches a thread that are in flight, as in `torchprt.transport.cluster`.
IN_FLIGHT = 2
# Rounds of whole batches of all threads that are followed one by one, and batches at least; the others take as much
# longer as the second half of these did.
FOLLOWED, FEW = 8, 2000


@dataclass
class Station:
    """Something that serves what comes in that order, `servers` at a time: `seconds` a batch, and `each` chunk."""

    name: str
    seconds: float = 0.0
    each: float = 0.0
    servers: int = 1
    _free: list[float] = field(default_factory=list, repr=False)

    def serve(self, now: float, chunks: int) -> float:
        """When a batch that comes now has been served."""
        seconds = self.seconds + chunks * self.each
        if not seconds:
            return now
        start = now if len(self._free) < self.servers else max(now, heapq.heappop(self._free))
        heapq.heappush(self._free, start + seconds)
        return start + seconds


@dataclass
class Work:
    """The way of a batch: stations `before` it is on a thread, those that its thread waits for (`reading`, then `each`
    seconds a chunk of its own, then `writing`), and those `after`."""

    before: list[Station]
    reading: list[Station]
    each: float
    writing: list[Station]
    after: list[Station]

    @property
    def stations(self) -> list[Station]:
        return [*self.before, *self.reading, *self.writing, *self.after]


def batches(chunks: int, threads: int, most: int) -> tuple[list[int], int, list[int]]:
    """How many chunks go out together, as `torchprt.transport.cluster` has it: those of the first batches, how many
    whole ones of `most` follow, and those of the last, which are cut finer."""
    first = [1] * min(chunks, IN_FLIGHT * threads)
    left, last = chunks - len(first), list[int]()
    # Of what is left each takes a quarter of the share of a thread, if that is less.
    whole = max(0, -(-(left - (most - 1) * 4 * threads) // most))
    left -= whole * most
    while left:
        size = max(1, min(most, -(-left // (4 * threads))))
        last.append(size)
        left -= size
    return first, whole, last


def makespan(chunks: int, threads: int, work: Work, most: int = 1) -> float:
    """Seconds until the results of all chunks are there, where at most so many go together.

    Laws: without stations and with `most` = 1 `ceil(chunks / threads) * work.each`; where a station is slower than all
    else all chunks and batches times its seconds, and the rest of one way.
    """
    first, whole, last = batches(chunks, threads, most)
    rounds = max(FOLLOWED, FEW // threads)
    if whole <= rounds * threads:
        return _end([*first, *[most] * whole, *last], threads, work)
    # As many as all beyond whole rounds of all threads, so that those that are left out are whole rounds.
    fewer, more = (whole % threads + part * threads for part in (rounds // 2, rounds))
    short, long = (_end([*first, *[most] * count, *last], threads, work) for count in (fewer, more))
    return long + (whole - more) / (more - fewer) * (long - short)


def _end(sizes: Sequence[int], threads: int, work: Work) -> float:
    """When the results of all batches are there."""
    own: list[float | Station] = [*work.reading, work.each, *work.writing]
    steps: list[float | Station] = [*work.before, *own, *work.after]
    for station in work.stations:
        station._free.clear()
    enters, leaves = len(work.before), len(work.before) + len(own)
    free, waiting, end = threads, deque[int](), 0.0
    given = min(len(sizes), IN_FLIGHT * threads)
    # The number of a batch decides between those that come at the same time.
    events: list[tuple[float, int, int]] = [(0.0, number, 0) for number in range(given)]

    def go(now: float, number: int, step: int) -> None:
        each = steps[step]
        now = each.serve(now, sizes[number]) if isinstance(each, Station) else now + sizes[number] * each
        heapq.heappush(events, (now, number, step + 1))

    while events:
        now, number, step = heapq.heappop(events)
        if step == leaves:
            free += 1
            if waiting:
                free -= 1
                go(now, waiting.popleft(), enters)
        if step == enters:
            if not free:
                waiting.append(number)
                continue
            free -= 1
        if step < len(steps):
            go(now, number, step)
            continue
        end = now
        if given < len(sizes):
            heapq.heappush(events, (now, given, 0))
            given += 1
    return end


def busy(chunks: int, threads: int, most: int, stations: Iterable[Station]) -> dict[str, float]:
    """Seconds that each station serves so many chunks, all its servers side by side."""
    first, whole, last = batches(chunks, threads, most)
    count, found = len(first) + whole + len(last), dict[str, float]()
    for each in stations:
        seconds = (count * each.seconds + chunks * each.each) / each.servers
        found[each.name] = found.get(each.name, 0.0) + seconds
    return found
