"""Directions and weights that integrate over the sphere; a rule of degree d is exact for order d + 1."""

import functools
import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.lebedev_rules import low_rule

# The degrees for which Lebedev and Laikov (1999) published rules with the symmetry of the octahedron.
_LEBEDEV_DEGREES = (*range(3, 32, 2), *range(35, 132, 6))
LARGEST_LEBEDEV_DEGREE = _LEBEDEV_DEGREES[-1]


def gauss_legendre(degree: int, dtype: torch.dtype = torch.float64) -> tuple[Float[Tensor, "D 3"], Float[Tensor, " D"]]:
    """The product rule exact for polynomials up to `degree`: Gauss-Legendre in z, equal steps around it.

    D = (degree // 2 + 1) (degree + 1) unit directions; the weights are positive and sum to 4 pi.
    A function of order n is projected exactly by degree 2(n - 1), a product of two by degree 3(n - 1).
    Raises InputError if `degree` is negative.
    """
    if degree < 0:
        raise InputError(f"degree must not be negative, but is {degree}")
    directions, weights = _gauss_legendre(degree)
    return torch.tensor(directions, dtype=dtype), torch.tensor(weights, dtype=dtype)


def gauss_legendre_hemisphere(
    degree: int, dtype: torch.dtype = torch.float64
) -> tuple[Float[Tensor, "D 3"], Float[Tensor, " D"]]:
    """The product rule over z > 0 that is exact for products of two harmonics whose bands add up to at most `degree`.

    Gauss-Legendre on 0 < z < 1, equal steps around it: what the steps around leave of such a product is a polynomial
    in z. D = (degree // 2 + 1) (degree + 1) unit directions; the weights are positive and sum to 2 pi.
    Raises InputError if `degree` is negative.
    """
    if degree < 0:
        raise InputError(f"degree must not be negative, but is {degree}")
    directions, weights = _gauss_legendre(degree)
    z = (directions[:, 2] + 1) / 2
    around = directions[:, :2] * (np.sqrt((1 - z) * (1 + z)) / np.sqrt(1 - directions[:, 2] ** 2))[:, None]
    return torch.tensor(np.column_stack([around, z]), dtype=dtype), torch.tensor(weights / 2, dtype=dtype)


def lebedev(degree: int, dtype: torch.dtype = torch.float64) -> tuple[Float[Tensor, "D 3"], Float[Tensor, " D"]]:
    """The smallest published Lebedev rule exact at least to `degree`: about two thirds of a product rule.

    Weights sum to 4 pi; those of degree 13, 25 and 27 are not all positive.
    Raises InputError if `degree` is negative or above 131.
    """
    if not 0 <= degree <= LARGEST_LEBEDEV_DEGREE:
        raise InputError(
            f"Lebedev rules exist for degrees 0 to 131, not {degree}: use gauss_legendre, which has no limit"
        )
    published = next(d for d in _LEBEDEV_DEGREES if d >= degree)
    rule = low_rule(published)
    if rule is None:
        from scipy.integrate import lebedev_rule

        directions, weights = lebedev_rule(published)
        rule = directions.T.copy(), weights
    return torch.tensor(rule[0], dtype=dtype), torch.tensor(rule[1], dtype=dtype)


def fibonacci(count: int, dtype: torch.dtype = torch.float64) -> tuple[Float[Tensor, "D 3"], Float[Tensor, " D"]]:
    """`count` unit directions on the spherical Fibonacci spiral about +z, with equal weights 4 pi / `count`.

    Not exact for any degree, but evenly spread for every count: for functions with edges, such as visibility.
    Raises InputError if `count` is below 1.
    Source: Marques et al. 2013, "Spherical Fibonacci point sets for illumination integrals".
    """
    if count < 1:
        raise InputError(f"count must be at least 1, not {count}")
    index = torch.arange(count, dtype=torch.float64)
    z = 1 - (2 * index + 1) / count
    # The fraction is taken before the angle, so that the last of a million directions is as exact as the
    # first.
    turn = 2 * math.pi * torch.frac(index * (2 / (1 + math.sqrt(5))))
    # 1 - z^2 in the form that keeps its digits near the poles.
    radius = torch.sqrt((1 - z) * (1 + z))
    directions = torch.stack([radius * torch.cos(turn), radius * torch.sin(turn), z], -1)
    return directions.to(dtype), torch.full((count,), 4 * math.pi / count, dtype=dtype)


@functools.lru_cache(maxsize=64)
def _gauss_legendre(degree: int) -> tuple[np.ndarray, np.ndarray]:
    z, weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    phi = 2 * np.pi * np.arange(degree + 1) / (degree + 1)
    radius = np.sqrt((1 - z) * (1 + z))
    directions = np.stack(
        [
            radius[:, None] * np.cos(phi),
            radius[:, None] * np.sin(phi),
            np.broadcast_to(z[:, None], (z.size, phi.size)),
        ],
        -1,
    )
    return directions.reshape(-1, 3), np.repeat(weights * 2 * np.pi / (degree + 1), degree + 1)
