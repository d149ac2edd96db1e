"""What workers in other processes hold of what tasks share."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Generic, TypeVar

R = TypeVar("R")


class Held(Generic[R]):
    """For each object that was sent, what stands for it at the workers: as long as the object lives here, so that a
    later stage need not send it again, and no longer, so that they hold no more than this process does."""

    def __init__(self) -> None:
        self._entries: list[tuple[Callable[[], object | None], R]] = []

    def of(self, thing: object, send: Callable[[object], R]) -> R:
        """What stands for `thing`; sends it if it was not sent before."""
        for known, sent in self._entries:
            if known() is thing:
                return sent
        sent = send(thing)
        self._entries.append((_known(thing), sent))
        return sent

    def gone(self) -> list[R]:
        """What stands for objects that live no more; forgotten here."""
        gone = [sent for known, sent in self._entries if known() is _GONE]
        self._entries = [entry for entry in self._entries if entry[0]() is not _GONE]
        return gone

    def forget(self) -> None:
        """Lets go of all, as when every worker that held it is gone."""
        self._entries = []

    @property
    def all(self) -> list[R]:
        """What stands for every object."""
        return [sent for _, sent in self._entries]


class _Gone:
    pass


_GONE = _Gone()


def _known(thing: object) -> Callable[[], object | None]:
    try:
        reference = weakref.ref(thing)
    except TypeError:
        # None and other plain values, which weigh nothing.
        return lambda: thing
    return lambda: _GONE if (found := reference()) is None else found
