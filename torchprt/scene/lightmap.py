"""What a caller asks for who wants to record at texels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from torchprt.errors import InputError

LARGEST = 16384
"""Texels along a side."""


@dataclass(frozen=True)
class Lightmap:
    """Record at the texels of a map instead of at vertices.

    - `size`: texels along a side of a square map, or (columns, rows).
    - `uv`: the set of texture coordinates that says where faces are on the map, from 0; "unwrap" makes charts anew;
      None takes what fits, see `charts_of`.
    - `samples`: places in a texel that its rays start from in turn: 1, 4, 9, 16, ..., a square grid.
    - `gutter`: how many texels around a chart are filled for what filters read beside it. Between charts that are made
      here lies twice that.

    Raises InputError if a number is out of range.
    """

    size: int | tuple[int, int] = 1024
    uv: int | Literal["unwrap"] | None = None
    samples: int = 4
    gutter: int = 4

    def __post_init__(self) -> None:
        for side in (self.columns, self.rows):
            if not 1 <= side <= LARGEST:
                raise InputError(f"a map of {self.columns} x {self.rows} texels: give 1 to {LARGEST} along each side")
        if not 1 <= self.samples <= 64 or math.isqrt(self.samples) ** 2 != self.samples:
            raise InputError(f"samples of a texel are {self.samples}: give a square number from 1 to 64")
        if not 0 <= self.gutter <= 256:
            raise InputError(f"gutter is {self.gutter} texels wide: give 0 to 256")
        if isinstance(self.uv, str) and self.uv != "unwrap":
            raise InputError(f"uv is {self.uv!r}: give the number of a set of texture coordinates, from 0, or 'unwrap'")
        if isinstance(self.uv, int) and self.uv < 0:
            raise InputError(f"uv is {self.uv}: give the number of a set of texture coordinates, from 0")

    @property
    def columns(self) -> int:
        return self.size if isinstance(self.size, int) else self.size[0]

    @property
    def rows(self) -> int:
        return self.size if isinstance(self.size, int) else self.size[1]

    @property
    def across(self) -> int:
        """Samples along a side of a texel."""
        return math.isqrt(self.samples)
