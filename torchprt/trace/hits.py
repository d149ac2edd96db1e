"""What rays hit."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Bool, Float, Int
from torch import Tensor


@dataclass
class Hits:
    """The nearest hit of every ray: `triangle` (-1 where it escapes), barycentrics `u`, `v` of the second and third
    corner, and whether the `front` of the triangle was hit (counter-clockwise corners seen from the ray)."""

    triangle: Int[Tensor, "*rays"]
    u: Float[Tensor, "*rays"]
    v: Float[Tensor, "*rays"]
    front: Bool[Tensor, "*rays"]
