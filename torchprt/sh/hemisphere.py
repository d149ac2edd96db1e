"""Functions on the hemisphere z > 0 in the basis of the whole sphere."""

from typing import Literal

import torch
from jaxtyping import Float64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import bands, basis
from torchprt.sh.quadrature import gauss_legendre_hemisphere

Kind = Literal["zero", "odd", "even", "optimal"]

# l = 1, m = 0: on the hemisphere the others reproduce it best of all.
DISCARDED = 2


def hemisphere_gram(order: int) -> Float64[Tensor, "N N"]:
    """`A_ik = int_H y_i y_k` over the hemisphere z > 0, float64, by a rule that is exact.

    Symmetric, positive definite; its eigenvalues pair as sigma, 1 - sigma, and the least fall fast: the condition is
    254 at order 3, 1.5e5 at 5, 3.5e9 at 8.
    Raises InputError if `order` is below 1.
    Source: Sloan, Hall, Hart and Snyder 2003, section 9.
    """
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    directions, weights = gauss_legendre_hemisphere(2 * (order - 1))
    values = basis(directions, order)
    return values.mT @ (weights[:, None] * values)


def hemisphere_projection(
    order: int, kind: Kind = "optimal", *, reduced: bool = False, ridge: float = 0.0
) -> Float64[Tensor, "N N"]:
    """P such that the coefficients `P b`, `b_i = int_H f y_i`, stand for a function f known on the hemisphere alone.

    - "zero": f is zero below the horizon, P = 1.
    - "odd", "even": f is mirrored, with or without a change of sign; P = 2 on the functions of that parity in z.
    - "optimal": the least-squares fit on the hemisphere, `P = A^-1`. With `reduced` the function l = 1, m = 0 is left
      out (row and column 2 of P are zero, 24 of 25 numbers at order 5 are stored): it costs the fit 1.5e-5 of the
      power at order 5 and spares it most of the condition. `ridge` is added to the diagonal of A.

    Raises InputError if `order` is below 1, `kind` is unknown, `ridge` is negative, or A is singular in float64
    (above order 9 without a ridge, 11 if reduced).
    Source: Sloan, Hall, Hart and Snyder 2003, section 9.
    """
    gram = hemisphere_gram(order)
    if kind == "zero":
        return torch.eye(len(gram), dtype=torch.float64)
    if kind in ("odd", "even"):
        band = bands(order)
        m = torch.arange(order**2) - band * (band + 1)
        odd = (band + m.abs()) % 2 == 1
        return torch.diag(torch.where(odd if kind == "odd" else ~odd, 2.0, 0.0).double())
    if kind != "optimal":
        raise InputError(f"kind '{kind}' of projection is unknown: use 'zero', 'odd', 'even' or 'optimal'")
    if not ridge >= 0:
        raise InputError(f"ridge is {ridge}: it must not be negative")
    kept = torch.ones(len(gram), dtype=torch.bool)
    if reduced and order > 1:
        kept[DISCARDED] = False
    part = gram[kept][:, kept] + ridge * torch.eye(int(kept.sum()), dtype=torch.float64)
    least, largest = torch.linalg.eigvalsh(part)[[0, -1]]
    if not float(least) > 16 * len(part) * torch.finfo(torch.float64).eps * float(largest):
        raise InputError(
            f"order {order} is too much for the hemisphere: its functions cannot be told apart in float64, "
            "lower the order or give a ridge"
        )
    inverse = torch.zeros_like(gram)
    inverse[kept.outer(kept)] = torch.cholesky_inverse(torch.linalg.cholesky(part)).flatten()
    return inverse


def hemisphere_error(
    projection: Float64[Tensor, "N N"], gram: Float64[Tensor, "N N"], order: int | None = None
) -> tuple[float, float]:
    """Worst and mean squared error, on the hemisphere, of signals of unit power projected by P.

    The signals have `order` bands (those of P by default): with `Q = (P A - 1)^T A (P A - 1)`, cut to them, the worst
    is the largest eigenvalue of Q and the mean its trace over their number.
    Raises InputError if `order` is above that of P.
    Source: Sloan, Hall, Hart and Snyder 2003, section 9.
    """
    count = len(projection) if order is None else order * order
    if count > len(projection):
        raise InputError(f"signals of order {order} have more than the {len(projection)} functions of the projection")
    change = projection @ gram - torch.eye(len(gram), dtype=gram.dtype)
    squared = (change.mT @ gram @ change)[:count, :count]
    return float(torch.linalg.eigvalsh(squared)[-1]), float(squared.trace()) / count
