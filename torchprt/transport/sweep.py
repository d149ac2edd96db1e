"""Light along parallel tracks through cells: what comes from outside, and what the cells send to each other."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.transport.tracks import Medium, Slices, Tracks

Cuts = dict[int, Int[Tensor, "E"]]
"""Tracks that end on a surface, by the part of the way before which they do: three of each slice that is met."""


def attenuated(
    medium: Medium, slices: Slices, along: Tracks, light: Float[Tensor, "T"], cuts: Cuts
) -> Float[Tensor, "D G"]:
    """What is left in each cell, on average, of light that enters on tracks, T of all directions; cells in slices.

    Exact for uniform cells, along the tracks. `light` is used up.
    """
    found = torch.zeros(len(along), len(slices.order))
    before = -1
    for step, rows in along.met(slices):
        sent = found[:, rows]
        for part in range(3):
            before = _cut(light, cuts, before, 3 * step + part)
            taken = along.taken(medium, slices, rows, step, part)
            number = along.numbers(slices, rows, step, part).flatten()
            here = light.index_select(0, number)
            gone = taken.flatten() * here
            sent += gone.view(len(along), -1)
            light.index_copy_(0, number, here - gone)
    depth = along.length.to(torch.float32)[:, None] * medium.extinction[slices.order]
    return found / depth


def scattered(
    medium: Medium,
    slices: Slices,
    along: Tracks,
    emission: Float[Tensor, "M G W"],
    toward: Float[Tensor, "D M"] | None,
    weights: Float[Tensor, "M D"],
    cuts: Cuts,
    arriving: Float[Tensor, "M G W"],
) -> None:
    """Adds to `arriving` what comes along these tracks to the cells from others and from themselves, on average over
    each, times `weights`. `emission`: the source radiance of each cell, of M functions of the direction that have the
    values `toward` along the tracks (None: one, which is 1). Cells in slices, both.
    """
    count, columns = len(along), emission.shape[2]
    light = torch.zeros(count * along.count, columns)
    by_length = weights / along.length.to(weights.dtype)
    total = weights.sum(1)
    before = -1
    for step, rows in along.met(slices):
        cells = emission[:, rows]
        sent = cells if toward is None else (toward @ cells.flatten(1)).view(count, -1, columns)
        gained = torch.zeros(count, rows.stop - rows.start, columns)
        for part in range(3):
            before = _cut(light, cuts, before, 3 * step + part)
            taken = along.taken(medium, slices, rows, step, part)[..., None]
            number = along.numbers(slices, rows, step, part).flatten()
            here = light.index_select(0, number).view_as(gained)
            gain = (sent - here).mul_(taken)
            gained += gain
            light.index_copy_(0, number, here.add_(gain).flatten(0, 1))
        # Of what a cell sends all that does not leave it stays in it.
        gained /= medium.extinction[slices.order[rows], None]
        kept = by_length @ gained.flatten(1)
        if toward is None:
            arriving[:, rows] += (total[:, None, None] * cells) - kept.view(len(weights), -1, columns)
        else:
            arriving[:, rows] += (weights @ sent.flatten(1) - kept).view(len(weights), -1, columns)


def _cut(light: Tensor, cuts: Cuts, before: int, now: int) -> int:
    """Surfaces that were met since are black."""
    if cuts:
        for number in range(before + 1, now + 1):
            if number in cuts:
                light.index_fill_(0, cuts[number], 0.0)
    return now
