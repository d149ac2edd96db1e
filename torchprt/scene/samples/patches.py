"""Small tileable reliefs to cover surfaces with: bumps, a waffle, wrinkles."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float64
from torch import Tensor

from torchprt.errors import InputError

from ..height_fields import height_field
from ..mesh import Mesh


def bumps(resolution: int = 48, depth: float | int = 0.13) -> Mesh:
    """Round bumps, two rows in a tile, every second one shifted by half: `resolution` by `resolution` vertices.

    Raises InputError if `resolution` is below 8, as all patches do.
    """
    x, y = _square(resolution)
    total = torch.zeros_like(x)
    for middle in (0.25, 0.75):
        # To the nearest copy of the bump.
        across, along = ((each - middle + 0.5) % 1 - 0.5 for each in (x, y))
        total = total + (1 - (across.square() + along.square()) / 0.33**2).clamp(min=0).square()
    return height_field(total, depth, "bumps")


def waffle(resolution: int = 48, depth: float | int = 0.16) -> Mesh:
    """Square pits between rounded walls, one in a tile."""
    x, y = _square(resolution)
    walls = [1 / (1 + torch.exp(-18 * (torch.cos(2 * math.pi * each) - 0.35))) for each in (x, y)]
    return height_field(1 - (1 - walls[0]) * (1 - walls[1]), depth, "waffle")


def wrinkles(resolution: int = 48, depth: float | int = 0.12) -> Mesh:
    """Creases that wander, branch and end, three across a tile."""
    x, y = _square(resolution)
    turn = 2 * math.pi
    wander = 0.16 * torch.sin(turn * y) + 0.07 * torch.sin(turn * (2 * y + x)) + 0.05 * torch.cos(turn * (y - 2 * x))
    phase = 3 * x + wander
    strength = 0.6 + 0.4 * torch.sin(turn * (y + 0.4 * torch.sin(turn * x) + 0.1))
    # Round ridges, and creases narrower than they.
    ridge = (torch.sin(math.pi * phase).square() + 0.02).sqrt() - 0.02**0.5
    return height_field(strength * ridge, depth, "wrinkles")


def _square(resolution: int) -> tuple[Float64[Tensor, "R R"], Float64[Tensor, "R R"]]:
    """x and y of the vertices of a tile, without its last column and row, which repeat the first."""
    if resolution < 8:
        raise InputError(f"resolution is {resolution}: give at least 8")
    ticks = torch.arange(resolution, dtype=torch.float64) / resolution
    y, x = torch.meshgrid(ticks, ticks, indexing="ij")
    return x, y
