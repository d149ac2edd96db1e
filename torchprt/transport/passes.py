"""Scattering passes: each cell passes on what it got, until next to nothing is added."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

# So many passes at most: a volume that nothing leaves would take any number.
LIMIT = 1000
# Former directions that a new one is made independent of: one is enough where all directions scatter alike, because
# what one cell gets from another is then what that gets from it.
_KEPT = 2


class VolumeWarning(UserWarning):
    """A grid too coarse for how dense it is, a phase function too narrow for the order, or passes without an end."""


@dataclass
class State:
    """How far passes have come: what has `arrived`, what is `missing` of it, and the directions in which it was sought
    with what a pass makes of them."""

    count: int
    arrived: Float[Tensor, "M G W"]
    missing: Float[Tensor, "M G W"]
    sought: list[Tensor] = field(default_factory=list)
    made: list[Tensor] = field(default_factory=list)

    def tensors(self) -> dict[str, Tensor]:
        """As a checkpoint keeps them."""
        several = {f"sought{i}": each for i, each in enumerate(self.sought)}
        several |= {f"made{i}": each for i, each in enumerate(self.made)}
        return {"count": torch.tensor(self.count), "arrived": self.arrived, "missing": self.missing, **several}

    @staticmethod
    def of(tensors: dict[str, Tensor]) -> State:
        """What `tensors` was."""
        number = sum(name.startswith("sought") for name in tensors)
        sought, made = ([tensors[f"{name}{i}"] for i in range(number)] for name in ("sought", "made"))
        return State(int(tensors["count"]), tensors["arrived"], tensors["missing"], sought, made)


Pass = Callable[[int, Tensor], Tensor]
"""What arrives of what has arrived once more: `(number, [M, G, W]) -> [M, G, W]`."""


def counted(direct: Float[Tensor, "M G W"], once: Pass, count: int, state: State | None, keep: Callable) -> State:
    """The sum of `count` passes after the light itself."""
    state = state or State(0, direct, direct)
    while state.count < count:
        added = once(state.count + 1, state.missing)
        state = State(state.count + 1, state.arrived + added, added)
        keep(state)
    return state


def endless(
    direct: Float[Tensor, "M G W"],
    once: Pass,
    weight: Float[Tensor, "#M G W"],
    enough: float,
    state: State | None,
    keep: Callable,
) -> State:
    """The sum of all passes, up to where the next would add less than `enough` of it (RMS).

    `a = direct + K a` is solved in every column by itself: the sum of passes is how it is defined, but a thick white
    cloud takes hundreds of them. Each step is one pass too, and takes what is best of all that were made (minimal
    residual, Orthomin), in the inner product of `weight`, in which K is symmetric if it scatters alike in all
    directions. `enough` is of the norm over all that scatter: what comes to others goes nowhere, and the pass that
    follows brings it.
    Warns (`VolumeWarning`) if more than `LIMIT` passes were wanted.
    Source: Vinsome 1976 (Orthomin); Eisenstat, Elman and Schultz 1983.
    """
    if state is None:
        state = _toward(State(0, torch.zeros_like(direct), direct), once, weight)
    scatter = weight > 0
    while True:
        sought, made = state.sought[-1], state.made[-1]
        share = _ratio(_inner(state.missing, made, weight), _inner(made, made, weight))
        state.arrived = state.arrived + share * sought
        state.missing = state.missing - share * made
        left, whole = (float((each * scatter).norm()) for each in (state.missing, state.arrived))
        if left <= enough * whole:
            return state
        if state.count >= LIMIT:
            warnings.warn(
                f"scattering was followed for {LIMIT} passes, after which {left / whole:.1e} of it is left",
                VolumeWarning,
                stacklevel=6,
            )
            return state
        state = _toward(state, once, weight)
        keep(state)


def _toward(state: State, once: Pass, weight: Tensor) -> State:
    """With one more direction, and one more pass."""
    sought = state.missing
    made = sought - once(state.count + 1, sought)
    for former, result in zip(state.sought, state.made, strict=True):
        share = _ratio(_inner(made, result, weight), _inner(result, result, weight))
        sought, made = sought - share * former, made - share * result
    directions, results = [*state.sought, sought][-_KEPT:], [*state.made, made][-_KEPT:]
    return State(state.count + 1, state.arrived, state.missing, directions, results)


def _inner(one: Tensor, other: Tensor, weight: Tensor) -> Float[Tensor, "W"]:
    return (one.double() * other.double() * weight).sum((0, 1))


def _ratio(above: Tensor, below: Tensor) -> Float[Tensor, "W"]:
    """Zero where there is nothing to divide: a column that is done."""
    least = torch.finfo(torch.float64).tiny
    return torch.where(below > least, above / below.clamp(min=least), 0).to(torch.float32)
