"""What long work tells while it runs."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Report(Protocol):
    """What listens to long work: a bar, or whatever has these two methods."""

    def start(self, stage: str, total: int, done: int = 0) -> None:
        """A stage begins: `total` rays (receivers for a bounce, points for compression), `done` were there already."""

    def advance(self, count: int) -> None:
        """`count` more are done."""


class Silent:
    """Tells nothing."""

    def start(self, stage: str, total: int, done: int = 0) -> None: ...

    def advance(self, count: int) -> None: ...
