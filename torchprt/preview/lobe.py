"""A function of the sphere as a surface: its distance from the middle is its magnitude."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt import sh

POSITIVE, NEGATIVE = (0.95, 0.25, 0.33), (0.2, 0.45, 0.85)
RINGS = 48
TOWARD = (0.4, 0.8, 0.45)
"""Where the faces of a lobe are brightest, so that its shape is seen without any light."""


@dataclass(frozen=True)
class Lobe:
    """A surface with sRGB vertex colours: red where the function is positive, blue where it is negative."""

    positions: Float[Tensor, "V 3"]
    faces: Int[Tensor, "F 3"]
    colours: Float[Tensor, "V 3"]


def sphere(rings: int) -> tuple[Float[Tensor, "V 3"], Int[Tensor, "F 3"]]:
    """Unit directions on `rings` + 1 circles of latitude with a seam at +z, float64, and faces seen from outside.

    Vertex `row * (2 rings + 1) + column` is at row / rings of the way from +y to -y and column / (2 rings) around, as
    in a latitude-longitude map.
    """
    theta = torch.linspace(0, math.pi, rings + 1, dtype=torch.float64)
    phi = torch.linspace(-math.pi, math.pi, 2 * rings + 1, dtype=torch.float64)
    t, p = torch.meshgrid(theta, phi, indexing="ij")
    directions = torch.stack([p.sin() * t.sin(), t.cos(), -p.cos() * t.sin()], -1).reshape(-1, 3)
    width = 2 * rings + 1
    corner = (torch.arange(rings)[:, None] * width + torch.arange(2 * rings)).reshape(-1)
    upper = torch.stack([corner, corner + width, corner + 1], -1)
    lower = torch.stack([corner + 1, corner + width, corner + width + 1], -1)
    return directions, torch.cat([upper, lower]).flip(1)


def lobe(
    coefficients: Float[Tensor, "N"], place: Float[Tensor, "3"], size: float | int, *, rings: int = RINGS
) -> Lobe | None:
    """The function of SH `coefficients` as a surface around `place` that reaches `size` far; None if it is zero."""
    directions, faces = sphere(rings)
    value = sh.basis(directions, math.isqrt(len(coefficients))) @ coefficients.double()
    largest = float(value.abs().max())
    if largest == 0:
        return None
    magnitude = value.abs() / largest
    positions = magnitude[:, None] * directions
    # Brighter where it reaches farther: a lobe toward the eye has no outline that would show it.
    shade = _shade(positions, faces) * (0.4 + 0.6 * magnitude)
    tint = torch.where((value >= 0)[:, None], torch.tensor(POSITIVE).double(), torch.tensor(NEGATIVE).double())
    return Lobe(place.double() + size * positions, faces, (tint * shade[:, None]).clamp(max=1))


def _shade(positions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "V"]:
    """A little light on the surface, 0.4 to 1.2, from the mean normal of the faces around each vertex."""
    a, b, c = positions[faces].unbind(1)
    crossed = torch.linalg.cross(b - a, c - a)
    total = torch.zeros_like(positions)
    for corner in range(3):
        total.index_add_(0, faces[:, corner], crossed)
    normals = torch.nn.functional.normalize(total, dim=-1)
    toward = torch.nn.functional.normalize(torch.tensor(TOWARD, dtype=positions.dtype), dim=0)
    return 0.8 + 0.4 * normals @ toward
