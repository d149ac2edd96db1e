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


def half_rule(
    fixed: Float64[Tensor, "D 3"], radial: int, around: int
) -> tuple[Float64[Tensor, "D Q 3"], Float64[Tensor, "D Q"]]:
    """For every `fixed` unit direction above the horizon, Q = `radial` * `around` other directions and weights.

    `around` is a multiple of 4. The weights of one fixed direction sum to 2 pi in the limit; the Jacobian of a
    reflection, 4 (h . fixed), is in them.
    """
    depth, depth_weights, turn, turn_weights = (torch.from_numpy(part) for part in _nodes(radial, around))
    z = fixed[:, 2:]
    across = torch.linalg.vector_norm(fixed[:, :2], dim=-1, keepdim=True)
    turned = across * turn.cos()
    longest = (math.pi / 4 + torch.atan2(turned, z) / 2)[..., None]
    tilt = longest * depth
    sine, cosine = tilt.sin(), tilt.cos()
    # At the pole any azimuth will do.
    phi = (torch.atan2(fixed[:, 1:2], fixed[:, :1]) + turn)[..., None]
    half = torch.stack([sine * phi.cos(), sine * phi.sin(), cosine], -1)
    along = turned[..., None] * sine + z[..., None] * cosine
    other = 2 * along[..., None] * half - fixed[:, None, None]
    weights = 4 * along * sine * (longest * depth_weights) * turn_weights[:, None]
    return other.flatten(1, 2), weights.flatten(1, 2)


@functools.lru_cache(maxsize=32)
def _nodes(radial: int, around: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Parts of the longest tilt and azimuths, both graded, with their weights."""
    depth, depth_weights = _graded(radial)
    step, step_weights = _graded(around // 4)
    turn = np.concatenate([math.pi / 2 * (side + way * step) for side in (1, -1) for way in (1, -1)])
    return depth, depth_weights, turn, np.tile(math.pi / 2 * step_weights, 4)


def _graded(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre on [0, 1] in a variable whose cube is integrated over: nodes crowd toward zero."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes = (nodes + 1) / 2
    return nodes**_GRADING, _GRADING * nodes ** (_GRADING - 1) * weights / 2
