"""How often light is followed from surface to surface."""

from __future__ import annotations

import math
from typing import Literal

from torchprt.errors import InputError
from torchprt.scene import Geometry

Bounces = int | float | Literal["auto"]
"""A whole number, `math.inf` for until light is spent, or "auto" for until a bounce adds next to nothing."""

# Bounces without end are over when one adds less than this part of the transfer (RMS): light is spent, or ("auto") no
# one would see more of it.
SPENT = 1e-4
UNSEEN = 1e-2


def check_bounces(bounces: Bounces) -> None:
    """Raises InputError unless `bounces` is what its type says."""
    if bounces == "auto":
        return
    if isinstance(bounces, str) or not bounces >= 0 or (bounces != math.inf and bounces != int(bounces)):
        raise InputError(f'bounces is {bounces}: give 0, a whole number, infinity or "auto"')


def followed(bounces: Bounces, geometry: Geometry, can: bool) -> tuple[int | float, float]:
    """How many bounces are computed at most, and the part of the transfer below which endless ones end.

    "auto" is none where they `can` not be held, or where no receiver reflects anything.
    """
    if bounces != "auto":
        assert not isinstance(bounces, str)
        return bounces, SPENT
    reflects = bool((geometry.albedo > 0).any() or (geometry.specular > 0).any())
    return (math.inf if can and reflects else 0), UNSEEN
