"""Poses of a model over time, for transfer that follows them."""

from __future__ import annotations

import math

from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.scene import bend

SWING = 0.5
"""How far the model bends to either side, in radians, if no poses are given."""
PERIOD = 4.0
"""Seconds of a bend to and fro."""
FIXED = 0.15
"""The share of the model's height at its foot that does not bend."""


class Animation:
    """Given poses `[T, V, 3]`, `rate` a second and around again, with straight lines between; or bending to and fro.

    `rest [V, 3]`: the rest pose, whose foot stays where it is.
    Raises InputError if there are no poses, or not of as many vertices, or one is not finite.
    """

    def __init__(
        self, rest: Float[Tensor, "V 3"], poses: Float[Tensor, "T W 3"] | None = None, *, rate: float | int = 24.0
    ):
        if poses is not None and (len(poses) == 0 or poses.shape[1] != len(rest)):
            raise InputError(
                f"poses are {len(poses)} of {poses.shape[1]} vertices: give one or more, each of {len(rest)}"
            )
        if poses is not None and not bool(poses.isfinite().all()):
            raise InputError("poses hold NaN or infinity: give finite positions")
        self.rest = rest
        self.poses = poses
        self.rate = rate
        low, high = float(rest[:, 1].min()), float(rest[:, 1].max())
        self._range = low + FIXED * (high - low), high

    def at(self, seconds: float | int) -> Float[Tensor, "V 3"]:
        """Positions of the vertices at a time; the rest pose at 0 if no poses were given."""
        if self.poses is None:
            low, high = self._range
            angle = SWING * math.sin(2 * math.pi * seconds / PERIOD)
            return bend(self.rest, angle, low, high) if low < high else self.rest
        place = seconds * self.rate % len(self.poses)
        first = int(place) % len(self.poses)
        then = (first + 1) % len(self.poses)
        return self.poses[first].lerp(self.poses[then], place - int(place)).to(self.rest.dtype)
