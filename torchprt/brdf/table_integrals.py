"""Integrals of a tabulated reflectance, cell by cell: what is linear between entries needs no refining."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from torchprt import sh
from torchprt.brdf.tabulated import Tabulated, around, steps, tilt
from torchprt.sh.constant import remembered

# Gauss-Legendre nodes in a cell, beyond the order: enough for harmonics over a cell as wide as the circle.
_NODES = 12
# Numbers held at once: 100 MB in float64.
_CHUNK = 12_000_000


def cell_integrals(
    brdf: Tabulated, fixed: Float64[Tensor, "D 3"], family: Callable[[Tensor, int], Tensor], order: int, *, views: bool
) -> Float64[Tensor, "D N"]:
    """int y_i(v) f(v, s) s_z dv for `fixed` lights s if `views`, else int y_i(s) f(v, s) s_z ds for fixed views v.

    As `integrals` for models, but without an error other than rounding: a table is a sum of products of hat functions
    of one angle each, so that its integrals are sums of products of integrals of one angle, and they are linear in
    the angles of the fixed direction as the table itself is. Zero at and below the horizon.
    """
    entries = _entries(torch.device("cpu"), brdf, family, order, views)
    band = sh.bands(order)
    m = torch.arange(order * order) - band * (band + 1)
    parts = [fixed.new_zeros(0, order * order)]
    for chunk in fixed.split(max(1, _CHUNK // (8 * order * order))):
        low, high, part = steps(tilt(chunk), len(entries))
        if brdf.isotropic:
            phi = torch.atan2(chunk[:, 1], chunk[:, 0])[:, None] * m.abs()
            held = torch.lerp(entries[low, 0], entries[high, 0], part[:, None])
            held = held * torch.where(m >= 0, phi.cos(), phi.sin())
        else:
            left, right, turn = around(chunk, entries.shape[1])
            before = torch.lerp(entries[low, left], entries[low, right], turn[:, None])
            after = torch.lerp(entries[high, left], entries[high, right], turn[:, None])
            held = torch.lerp(before, after, part[:, None])
        if views:
            held = held * chunk[:, 2:]
        parts.append(torch.where(chunk[:, 2:] > 0, held, 0.0))
    return torch.cat(parts)


@remembered(64)
def _entries(
    brdf: Tabulated, family: Callable[[Tensor, int], Tensor], order: int, views: bool
) -> Float64[Tensor, "T P N"]:
    """The integrals for fixed directions at the angles of the table, azimuths second (azimuth 0 alone if isotropic).

    Without s_z if s is fixed.
    """
    values = brdf.values.double().cpu()
    # Angle and azimuth of the fixed direction, then of the other one.
    if brdf.isotropic:
        values = (values.transpose(0, 1) if views else values)[:, None]
    else:
        values = values.permute(2, 3, 0, 1) if views else values
    band = sh.bands(order)
    m = torch.arange(order * order) - band * (band + 1)
    theta, hats = _hats(values.shape[2], math.pi / 2, order)
    # At azimuth 0: m and -m have the same part in theta.
    along = family(torch.stack([theta.sin(), torch.zeros_like(theta), theta.cos()], -1), order)
    along = along[:, band * (band + 1) + m.abs()] * (theta.sin() if views else theta.sin() * theta.cos())[:, None]
    count = values.shape[3]
    waves = torch.arange(order)
    if brdf.isotropic:
        phi, round_hats = _hats(count, math.pi, order)
        # The other half of the circle is the mirror image.
        turns = round_hats @ torch.cat([2 * (phi[:, None] * waves).cos(), torch.zeros(len(phi), order)], 1)
    else:
        phi, round_hats = _hats(count + 1, 2 * math.pi, order)
        round_hats = torch.cat([round_hats[:1] + round_hats[-1:], round_hats[1:-1]])
        turn = phi[:, None] * waves
        turns = round_hats @ torch.cat([turn.cos(), turn.sin()], 1)
    which = torch.where(m >= 0, m, order - m)
    found = torch.einsum("bqai,ai->bqi", (values @ turns)[..., which], hats @ along)
    if brdf.isotropic:
        # The function of -m stands for m where the fixed direction is turned.
        found = found[..., band * (band + 1) + m.abs()]
    return found


def _hats(count: int, length: float, order: int) -> tuple[Float64[Tensor, " Q"], Float64[Tensor, "T Q"]]:
    """Nodes on [0, length] and the hat functions of `count` equal steps at them, times the weights of the nodes."""
    nodes, weights = (torch.from_numpy(part) / 2 for part in np.polynomial.legendre.leggauss(_NODES + order))
    step = length / (count - 1)
    within = (nodes + 0.5).repeat(count - 1)
    cell = torch.arange(count - 1).repeat_interleave(len(nodes))
    place = torch.arange(len(cell))
    hats = torch.zeros(count, len(cell), dtype=torch.float64)
    hats[cell, place] = 1 - within
    hats[cell + 1, place] = within
    return (cell + within) * step, hats * (weights.repeat(count - 1) * step)
