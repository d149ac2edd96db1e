"""Coefficients of a function that can be called, or of scattered samples."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import basis, values_are_at_hand
from torchprt.sh.quadrature import gauss_legendre

# How far beyond order n the default rule stays exact, for functions that are smooth but not of order n.
_SPARE_DEGREE = 32


def project_function(
    function: Callable[[Tensor], Tensor],
    order: int,
    degree: int | None = None,
    dtype: torch.dtype = torch.float64,
) -> Float[Tensor, "N C"]:
    """SH coefficients of `function`, which maps unit directions `[D, 3]` to values `[D, C]`.

    Gauss-Legendre quadrature of `degree`, by default 2 (order - 1) + 32: exact for functions of `order` and
    bands up to order + 31. Functions with edges need more: the error falls with 1 / degree only.
    Raises InputError if `order` is below 1 or the function returns another shape.
    Source: Sloan, Kautz and Snyder 2002, section 3, equation 2.
    """
    directions, weights = gauss_legendre(2 * (max(order, 1) - 1) + _SPARE_DEGREE if degree is None else degree, dtype)
    values = function(directions)
    if values.dim() != 2 or values.shape[0] != directions.shape[0]:
        raise InputError(
            f"function returned shape {list(values.shape)} for {len(directions)} directions: return [D, C]"
        )
    return (basis(directions, order) * weights[:, None]).mT @ values


def project_samples(
    values: Float[Tensor, "*B D C"],
    directions: Float[Tensor, "D 3"],
    order: int,
    weights: Float[Tensor, " D"] | None = None,
) -> Float[Tensor, "*B N C"]:
    """The SH coefficients that fit `values` at unit `directions` best, in the (weighted) least-squares sense.

    Minimises sum_d w_d |f(s_d) - value_d|^2 by QR, with w = 1 by default; gradients flow to `values`.
    Raises InputError if a weight is negative or the samples do not determine all N coefficients; in a traced graph and
    under torch.func only if there are too few of them.
    """
    table = basis(directions, order)
    if weights is not None:
        if values_are_at_hand(weights) and not bool(weights.ge(0).all()):
            raise InputError("weights must be zero or more: least squares has no meaning otherwise")
        root = weights.sqrt().unsqueeze(-1)
        table, values = table * root, values * root
    count, unknowns = table.shape
    determined = count >= unknowns
    if determined and values_are_at_hand(table):
        spread = torch.linalg.svdvals(table.detach())
        determined = bool(spread[-1] > count * torch.finfo(table.dtype).eps * spread[0])
    if not determined:
        raise InputError(
            f"{count} samples do not determine the {unknowns} coefficients of order {order}: "
            "give more directions, spread over the sphere, or a lower order"
        )
    q, r = torch.linalg.qr(table)
    return torch.linalg.solve_triangular(r, q.mT @ values, upper=True)
