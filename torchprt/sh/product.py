"""Products of functions in their coefficients: the Gaunt tensor, vectors and matrices."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import basis, order_of
from torchprt.sh.constant import remembered
from torchprt.sh.quadrature import gauss_legendre

# Rounding of the quadrature stays below 1e-14, and the smallest Gaunt coefficient up to order 32 above 1e-6.
_NOTHING = 1e-10


def gaunt(order_a: int, order_b: int, order_c: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, "A B C"]:
    """The integrals of y_i y_j y_k over the sphere, dense; those that vanish are exact zeros.

    Symmetric in its indices. 83, 1158 and 65913 non-zeros for three times order 3, 5 and 11. Dense: at three
    times order 20 half a gigabyte; use `product` there.
    Raises InputError if an order is below 1.
    Source: Sloan, Kautz and Snyder 2002, section 4.2 (the triple product).
    """
    return _gaunt(torch.device("cpu"), order_a, order_b, order_c, torch.float64).to(dtype, copy=True)


def product(
    a: Float[Tensor, "*#B Na #C"], b: Float[Tensor, "*#B Nb #C"], order: int | None = None
) -> Float[Tensor, "... N C"]:
    """SH coefficients up to `order` of the product of two functions.

    Leading dimensions and channels broadcast. `order` is by default the larger of the two; the whole product
    has order_a + order_b - 1. Evaluated, multiplied and projected by a rule exact for all three, so the only
    loss is what lies above `order`.
    Law: product(a, b) = product(b, a). Gradients flow to both.
    Raises InputError if a count of coefficients is not a square number or `order` is below 1.
    """
    order_a, order_b = order_of(a.shape[-2]), order_of(b.shape[-2])
    order = max(order_a, order_b) if order is None else order
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    table, project = _tables(a.device, order_a, order_b, order, a.dtype)
    return project @ ((table[:, : order_a**2] @ a) * (table[:, : order_b**2] @ b))


def product_matrix(a: Float[Tensor, "*B N"], order_in: int, order_out: int) -> Float[Tensor, "*B out in"]:
    """The matrix that multiplies a function of `order_in` by `a` and projects the result to `order_out`.

    M_ij = sum_k a_k int y_i y_j y_k: the transfer matrix of a visibility `a`. Symmetric if square.
    Raises InputError if N is not a square number or an order is below 1.
    Source: Sloan, Kautz and Snyder 2002, section 4.2, equation 12.
    """
    tensor = _gaunt(a.device, order_of(a.shape[-1]), order_out, order_in, a.dtype)
    return (a @ tensor.flatten(1)).unflatten(-1, tensor.shape[1:])


@remembered(16)
def _gaunt(order_a: int, order_b: int, order_c: int, dtype: torch.dtype) -> Tensor:
    orders = (order_a, order_b, order_c)
    if min(orders) < 1:
        raise InputError(f"orders must be at least 1, not {orders}")
    directions, weights = gauss_legendre(sum(orders) - 3)
    table = basis(directions, max(orders))
    left = table[:, : order_a**2].mT.unsqueeze(1) * (table[:, : order_b**2].mT * weights)
    values = (left.flatten(0, 1) @ table[:, : order_c**2]).unflatten(0, left.shape[:2])
    return torch.where(values.abs() > _NOTHING, values, 0.0).to(dtype)


@remembered(32)
def _tables(order_a: int, order_b: int, order: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    directions, weights = gauss_legendre(order_a + order_b + order - 3)
    table = basis(directions, max(order_a, order_b, order))
    project = (table[:, : order**2] * weights[:, None]).mT
    return table.to(dtype).contiguous(), project.to(dtype).contiguous()
