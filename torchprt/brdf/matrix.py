"""What a BRDF does to light written in spherical harmonics: exit kernels, BRDF matrices, what an order loses."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt import sh
from torchprt.brdf.integrals import TOLERANCE, integrals
from torchprt.brdf.models import Brdf
from torchprt.errors import InputError
from torchprt.sh import Projection

_LARGEST_DEGREE = 512


def exit_kernel(
    brdf: Brdf, directions: Float[Tensor, "D 3"], order: int, projection: Projection = "optimal"
) -> Float64[Tensor, "M D"]:
    """K_i(s): the coefficients, in the exit functions of `order`, of what light from s becomes, v -> f(v, s) s_z.

    A receiver's exit matrix is M_ij = int V(s) K_i(s) y_j(s) ds, s in its local frame: the incident side is integrated
    against the rays themselves, so of the product M = P B P T of the paper only the first P and B remain.
    "optimal": K_i = int_H h_i f s_z dv in `sh.hemisphere_basis`; else P b, b_i = int_H y_i f s_z dv, with P of
    `sh.hemisphere_projection`. Right to 3e-5 of the RMS, 1e-3 if f is a function of the user's with edges or Phong's
    model with an exponent below 1; exact for a table. Zero at and below the horizon.
    Raises InputError if directions are not of unit length, `order` is below 1, `projection` is unknown or cannot be
    solved at that order, or the lobe is too narrow or too rough to be integrated.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3 and 9.
    """
    sh.exit_count(order, projection)
    sh.check_directions(directions)
    fixed = directions.detach().double()
    if projection == "optimal":
        return integrals(brdf, fixed, sh.hemisphere_basis, order, over="views").mT
    return _projection(order, projection) @ integrals(brdf, fixed, sh.basis, order, over="views").mT


def brdf_matrix(brdf: Brdf, order_out: int, order_in: int) -> Float64[Tensor, "No Ni"]:
    """B_ij = int_H int_H y_i(v) y_j(s) f(v, s) s_z ds dv, from incident to exit radiance in the local frame.

    Laws: rows and columns of different m do not mix if the BRDF is isotropic. The weight s_z stands with the light
    alone, so B is not symmetric even if f is reciprocal. Right to about 1e-4 of its norm.
    Raises InputError if an order is below 1 or the lobe is too narrow to be integrated.
    Source: Sloan, Hall, Hart and Snyder 2003, section 3.1.
    """
    for order in (order_out, order_in):
        sh.exit_count(order)
    return _matrix(brdf, sh.basis, order_out, sh.basis, order_in)


def exit_chain(brdf: Brdf, order: int, order_in: int, projection: Projection = "optimal") -> Float64[Tensor, "M Ni"]:
    """P B P: from transferred incident radiance to the coefficients of exit radiance.

    It is applied to b_j = int_H V y_j L ds, the coefficients of light in the local frame that is zero below the
    horizon and where shadowed (T l in the notation of the papers), of `order_in`. Under "optimal" these become the
    function that fits on the hemisphere best, through y = R h on the hemisphere, h = `sh.hemisphere_basis`: R^-1 b,
    whose condition is the square root of that of A. The kernels of `exit_kernel` need no such fit: use them where the
    rays are at hand.
    Raises InputError as `exit_kernel`.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3 and 9.
    """
    for one in (order, order_in):
        sh.exit_count(one, projection)
    if projection == "optimal":
        incident = _matrix(brdf, sh.hemisphere_basis, order, sh.hemisphere_basis, order_in)
        directions, weights = sh.gauss_legendre_hemisphere(2 * (order_in - 1))
        onto = sh.basis(directions, order_in).mT @ (weights[:, None] * sh.hemisphere_basis(directions, order_in))
        return torch.linalg.solve(onto, incident, left=False)
    between = _matrix(brdf, sh.basis, order, sh.basis, order_in)
    return _projection(order, projection) @ between @ _square_projection(order_in, projection)


def exit_error(brdf: Brdf, order: int, light_order: int = 5, projection: Projection = "optimal") -> float:
    """What exit functions of `order` cannot represent: relative RMS error of unshadowed exit radiance.

    The mean is over exit directions (by solid angle) and over lights of independent coefficients of equal variance,
    of `light_order`. Exact exit radiance is integrated over the lights for each exit direction.
    Raises InputError if an order is below 1, `projection` is unknown or cannot be solved, or the lobe is too narrow.
    """
    sh.exit_count(order, projection)
    sh.exit_count(light_order)
    directions, weights, exact = exit_radiance(brdf, order, light_order)
    family = sh.hemisphere_basis if projection == "optimal" else sh.basis
    products = family(directions, order).mT @ (weights[:, None] * exact)
    coefficients = products if projection == "optimal" else _projection(order, projection) @ products
    rest = exact - sh.exit_functions(directions, order, projection) @ coefficients
    power = float((weights[:, None] * exact.square()).sum())
    return math.sqrt(float((weights[:, None] * rest.square()).sum()) / power) if power > 0 else 0.0


def exit_radiance(
    brdf: Brdf, order: int, light_order: int
) -> tuple[Float64[Tensor, "D 3"], Float64[Tensor, " D"], Float64[Tensor, "D N"]]:
    """Views and weights that integrate products with exit functions of `order`, and the exact radiance toward them
    under each function of an unshadowed light."""
    # Exit radiance is smooth on the scale of the light, or of the lobe near the horizon.
    degree = max(4 * order, 96, min(int(8 / brdf.width), _LARGEST_DEGREE))
    directions, weights = sh.gauss_legendre_hemisphere(degree)
    return directions, weights, integrals(brdf, directions, sh.basis, light_order, over="lights")


def _matrix(brdf: Brdf, family_out, order_out: int, family_in, order_in: int) -> Tensor:  # type: ignore[no-untyped-def]
    degree, last = 32 + order_out + order_in, None
    while degree <= 2 * _LARGEST_DEGREE:
        directions, weights = sh.gauss_legendre_hemisphere(degree)
        kernels = integrals(brdf, directions, family_out, order_out, over="views")
        found = kernels.mT @ (weights[:, None] * family_in(directions, order_in))
        if last is not None and float((found - last).norm()) <= 2 * TOLERANCE * float(found.norm()):
            return found
        degree, last = 2 * degree, found
    raise InputError(f"the reflectance '{brdf.spec}' is too narrow for a matrix: use a wider lobe")


def _projection(order: int, projection: Projection) -> Float64[Tensor, "M N"]:
    """From the products of a function with the spherical harmonics to the coefficients of exit functions."""
    square = _square_projection(order, projection)
    # "reduced" leaves one row out, which is zero here.
    return square[square.abs().sum(1) > 0] if projection == "reduced" else square


def _square_projection(order: int, projection: Projection) -> Float64[Tensor, "N N"]:
    if projection == "reduced":
        return sh.hemisphere_projection(order, "optimal", reduced=True)
    return sh.hemisphere_projection(order, projection)
