"""Where the refinement of lobes starts from: what is left, the neighbours, other lobes given up, random axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from torchprt.compression.lobe_axes import Target, fit_heights, sum_of_lobes
from torchprt.compression.lobe_refinement import CHUNK, Workers, refine
from torchprt.compression.single_lobe import best_axis

# How far a start is refined: one that lobes are added to, one that must prove itself, one that was drawn, the last.
_ROUGH: dict[str, Any] = {"iterations": 6, "tolerance": 1e-1}
_TRIAL: dict[str, Any] = {"iterations": 10, "tolerance": 1e-2}
_DRAWN: dict[str, Any] = {"iterations": 40, "tolerance": 1e-3}
_LAST: dict[str, Any] = {"iterations": 30, "tolerance": 1e-3}
_RELEASED: dict[str, Any] = {"iterations": 5, "tolerance": 1e-3}
# Lobes are better if they leave so much less, of what is left and of the power: passes over the mesh come to an end.
_LESS, _LEAST = 1e-3, 1e-6
_PASSES = 20
# Lobes are exchanged, and started from random axes, where the squared error is above so much of the mean.
_EXCHANGED, _RESTARTED = 0.1, 0.5
# How often the ridge is moved to the heights that were found: so it costs nothing where lobes are well apart.
_RELEASES = 4
# What the steps of the search take beside that of adding a lobe, about: of a scan, four lobes.
_SPREAD, _EXCHANGE, _RESTART, _FINISH = 8, 4, 4, 6
# A vector that one lobe holds to the rounding of its power is that lobe, refined to the end: the ridge would rather
# have several in one place.
_END: dict[str, Any] = {"iterations": 6, "tolerance": 0.0}


def cost(lobes: int, restarts: int, exchanged: bool) -> int:
    """How much a search tells of for each of its vectors; whether lobes are `exchanged` too."""
    return lobes + _SPREAD + exchanged * lobes * _EXCHANGE + restarts * _RESTART + _FINISH


class Search:
    """The best lobes so far of every vector: `axes [L, 3, V]`, and `error [V]` as `refine` gives it.

    `target`: vectors of unit power, or zero; `size [V]`: what they were divided by; `edges [E, 2]`: pairs of points,
    both ways round. `tell` is told what is done, in all `cost` for each vector.
    """

    def __init__(
        self, target: Target, size: Tensor, edges: Tensor, workers: Workers, tell: Callable[[int], None], lobes: int
    ) -> None:
        self.target, self.edges, self.workers, self.tell = target, edges, workers, tell
        self.power = target.vectors.square().sum((0, 1))
        largest = size.double().amax() if len(size) else 1.0
        self.weight = (size.double() / torch.where(size > 0, largest, 1.0)).square()
        # One lobe after the other on what is left, all of them refined together.
        self.axes, rest = target.vectors.new_zeros(0, 3, len(target)), target.vectors
        for count in range(1, lobes + 1):
            axes = torch.cat([self.axes, best_axis(rest, target.first, workers)[None]])
            steps = _LAST if count == 1 else _TRIAL if count == lobes else _ROUGH
            some = replace(target, ridge=0.0) if count == 1 else target
            self.axes, self.error = refine(some, axes, workers, **steps)
            rest = self._residual(some, self.axes)
            if count == 1:
                self.held = rest.square().sum((0, 1)) <= self.power * torch.finfo(rest.dtype).eps
                self.single, _ = refine(some[self.held], self.axes[..., self.held], workers, **_END)
            tell(len(target))
        self._spread(torch.ones_like(self.error, dtype=torch.bool))
        tell(_SPREAD * len(target))

    def exchange(self) -> None:
        """Gives up each of the lobes in turn, for the best one on what the others leave."""
        for given in range(len(self.axes)):
            points = self._where_error_is_high(_EXCHANGED)
            some, kept = self.target[points], torch.cat([self.axes[:given], self.axes[given + 1 :]])[..., points]
            rest = self._residual(some, kept) if len(kept) else some.vectors
            axes = torch.cat([kept, best_axis(rest, some.first, self.workers)[None]])
            self._spread(self._try(points, axes, _TRIAL))
            self.tell(_EXCHANGE * len(self.target))

    def restart(self, times: int, generator: torch.Generator) -> None:
        """Random axes where the error is high, so many times."""
        done = 0
        while done < times:
            points = self._where_error_is_high(_RESTARTED)
            # Of few vectors many at once.
            draws = max(1, min(times - done, CHUNK // max(len(points), 1)))
            axes = torch.randn(
                len(self.axes), 3, draws * len(points), generator=generator, dtype=torch.float64, device="cpu"
            )
            axes = torch.nn.functional.normalize(axes, dim=1).to(self.axes)
            axes, error = refine(self.target[points.repeat(draws)], axes, self.workers, **_DRAWN)
            best = error.view(draws, -1).argmin(0) * len(points) + torch.arange(len(points), device=error.device)
            self._spread(self._try(points, axes[..., best], _TRIAL))
            done += draws
            self.tell(draws * _RESTART * len(self.target))

    def finish(self) -> Tensor:
        """Heights `[L, C, B, V]` of the axes, which are refined as far as they go."""
        self.axes, _ = refine(self.target, self.axes, self.workers, **_LAST)
        target, heights = self.target, self._heights(self.target)
        for _ in range(_RELEASES):
            target = replace(target, heights=heights)
            self.axes, _ = refine(target, self.axes, self.workers, **_RELEASED)
            heights = self._heights(target)
        alone, _ = fit_heights(replace(self.target, ridge=0.0)[self.held], self.single)
        heights[..., self.held] = torch.cat([alone, alone.new_zeros(len(heights) - 1, *alone.shape[1:])])
        self.axes[..., self.held] = self.single
        self.tell(_FINISH * len(self.target))
        return heights

    def _try(self, points: Tensor, axes: Tensor, steps: dict[str, Any]) -> Tensor:
        """Refines `axes` at some `points`, keeps them where they are better: which of all these are, `[V]`."""
        axes, error = refine(self.target[points], axes, self.workers, **steps)
        former, power = self.error[points], self.power[points]
        better = error < former - _LESS * (power + former) - _LEAST * power
        chosen = points[better]
        self.axes[..., chosen], self.error[chosen] = axes[..., better], error[better]
        changed = torch.zeros_like(self.power, dtype=torch.bool)
        changed[chosen] = True
        return changed

    def _spread(self, changed: Tensor) -> None:
        """Starts vectors from the axes of the best of their neighbours that `changed`, until none does."""
        for _ in range(_PASSES):
            edges = self.edges[changed[self.edges[:, 1]]]
            if not len(edges):
                return
            error = self._error_at(edges)
            least = torch.full_like(self.error, torch.inf).scatter_reduce(0, edges[:, 0], error, "amin")
            best = edges[error <= least[edges[:, 0]]]
            # Of equals, the last.
            origin = torch.full_like(self.edges[:, 0].new_zeros(len(self.error)), -1)
            origin = origin.scatter_reduce(0, best[:, 0], best[:, 1], "amax")
            points = (origin >= 0).nonzero()[:, 0]
            changed = self._try(points, self.axes[..., origin[points]], _TRIAL)

    def _error_at(self, edges: Tensor) -> Tensor:
        """What the first of a pair would leave with the axes of the second, `[E]`."""

        def work(rows: slice) -> Tensor:
            first, second = edges[rows].unbind(1)
            return fit_heights(self.target[first], self.axes[..., second])[1]

        return torch.cat(self.workers.map(work, len(edges)))

    def _heights(self, target: Target) -> Tensor:
        def work(rows: slice) -> Tensor:
            return fit_heights(target[rows], self.axes[..., rows])[0]

        return torch.cat(self.workers.map(work, len(target)), -1)

    def _where_error_is_high(self, part: float) -> Tensor:
        squared = (self.power + self.error).clamp(min=0) * self.weight
        return (squared >= part * squared.mean()).nonzero()[:, 0]

    def _residual(self, target: Target, axes: Tensor) -> Tensor:
        def work(rows: slice) -> Tensor:
            heights, _ = fit_heights(target[rows], axes[..., rows])
            return target.vectors[..., rows] - sum_of_lobes(axes[..., rows], heights, target.order, target.first)

        return torch.cat(self.workers.map(work, len(target)), -1)
