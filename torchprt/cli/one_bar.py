"""One bar for a compression, which is many stages."""

from __future__ import annotations

from torchprt.progress import Report

# Shares of a search, and of an encoding, about. A search encodes again and again, and never says how often.
SEARCH = 0.4
ENCODING = {"clusters": 0.15, "growing": 0.5, "dropping": 0.1, "refining": 0.15, "weights": 0.1}
OTHER = 0.1
LENGTH = 1000


class OneBar:
    """A report of stages as one stage `name` of a `bar` that never goes back.

    `searching`: encodings follow a search; each is taken for half of what is left.
    """

    def __init__(self, bar: Report, name: str, searching: bool) -> None:
        self._bar, self._name, self._searching = bar, name, searching
        self._begun, self._told = False, 0
        # Where the bar is, where this encoding and this stage will have brought it, and how much work the stage is.
        self._place, self._try, self._goal, self._total = 0.0, 1.0, 0.0, 0
        self._done = 0

    def start(self, stage: str, total: int, done: int = 0) -> None:
        if not self._begun:
            self._bar.start(self._name, LENGTH)
            self._begun = True
        self._place = max(self._place, self._goal)
        if stage == "clusters":
            self._try = (1 - self._place) * (0.5 if self._searching else 1.0)
        share = SEARCH if stage == "sampling" else ENCODING.get(stage, OTHER) * self._try
        self._goal = self._place + min(share, 0.95 * (1 - self._place))
        self._total, self._done = total, 0
        self.advance(done)

    def advance(self, count: int) -> None:
        self._done += count
        part = min(1.0, self._done / self._total) if self._total else 1.0
        # It is full at the end only, however close the rounding of shares comes.
        self._tell(min(self._place + part * (self._goal - self._place), 1 - 1 / LENGTH))

    def end(self) -> None:
        """All is done."""
        if self._begun:
            self._tell(1.0)

    def _tell(self, place: float) -> None:
        more = int(place * LENGTH) - self._told
        if more > 0:
            self._told += more
            self._bar.advance(more)
