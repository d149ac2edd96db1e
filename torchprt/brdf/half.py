"""Quadrature over the hemisphere that follows the lobe: over half directions, which gather about the normal.

The lobe of a glossy surface is narrow and moves with the fixed direction; seen from the half direction
h = (v + s) / |v + s| it stands still about the normal. With the fixed direction at the angle theta from the normal and
h at (t, phi), phi counted from it, the other direction has the z coordinate A cos(2 t - d), d = atan2(sin(theta)
cos(phi), cos(theta)): it is above the horizon just when t < pi / 4 + d / 2. So the range of t is known in closed form,
the rule never cuts the integrand, and t and phi are graded toward the normal and toward phi = 90 degrees, where d turns
over when the fixed direction grazes.
"""

from __future__ import annotations

import functools
import math

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

_GRADING = 3


def half_rule(fixed: Float64[Tensor, "D 3"], level: int) -> tuple[Float64[Tensor, "D Q 3"], Float64[Tensor, "D Q"]]:
    """For every `fixed` unit direction above the horizon, Q = 2 `level`^2 other directions and weights in steradians.

    The weights of one fixed direction sum to 2 pi in the limit of high levels; the Jacobian of a reflection,
    4 (h . fixed), is in them.
    """
    radial, radial_weights, around, around_weights = (torch.from_numpy(part) for part in _nodes(level))
    z = fixed[:, 2:]
    across = torch.linalg.vector_norm(fixed[:, :2], dim=-1, keepdim=True)
    # At the pole any azimuth will do.
    azimuth = torch.atan2(fixed[:, 1:2], fixed[:, :1])
    turned = across * around.cos()
    longest = math.pi / 4 + torch.atan2(turned, z) / 2
    tilt = longest[..., None] * radial**_GRADING
    stretch = longest[..., None] * (_GRADING * radial ** (_GRADING - 1) * radial_weights)
    sine, cosine = tilt.sin(), tilt.cos()
    phi = (azimuth + around)[..., None]
    half = torch.stack([sine * phi.cos(), sine * phi.sin(), cosine], -1)
    along = turned[..., None] * sine + z[..., None] * cosine
    other = 2 * along[..., None] * half - fixed[:, None, None]
    weights = 4 * along * sine * stretch * around_weights[:, None]
    return other.flatten(1, 2), weights.flatten(1, 2)


@functools.lru_cache(maxsize=16)
def _nodes(level: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    nodes, weights = np.polynomial.legendre.leggauss(level)
    radial, radial_weights = (nodes + 1) / 2, weights / 2
    nodes, weights = np.polynomial.legendre.leggauss(level // 2)
    away = (nodes + 1) / 2
    step = math.pi / 2 * away**_GRADING
    step_weights = math.pi / 2 * _GRADING * away ** (_GRADING - 1) * weights / 2
    around = np.concatenate([side * math.pi / 2 + way * step for side in (1, -1) for way in (1, -1)])
    return radial, radial_weights, around, np.tile(step_weights, 4)
