"""As few nodes of the hemisphere as functions of some degree need to be told by their values."""

import torch
from jaxtyping import Float64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.constant import remembered
from torchprt.sh.hemisphere_basis import hemisphere_basis
from torchprt.sh.quadrature import gauss_legendre_hemisphere


def hemisphere_nodes(degree: int) -> tuple[Float64[Tensor, "K 3"], Float64[Tensor, "K K"]]:
    """K = (degree + 1)^2 unit directions above the horizon, and from values there to the coefficients in
    `hemisphere_basis` of order `degree` + 1 of the one polynomial of that degree that has them.

    `coefficients = fit @ values`. About half as many as those of a rule whose quadrature gives the same coefficients,
    `gauss_legendre_hemisphere(2 degree)`, from which they are chosen: those that span the largest volume, by QR with
    pivots. Rounding grows by at most 20 up to degree 26, which two functions of order 14 reach.
    Raises InputError if `degree` is negative.
    Source: Sommariva and Vianello 2009, "Computing approximate Fekete points by QR factorizations of Vandermonde
    matrices".
    """
    if degree < 0:
        raise InputError(f"degree is {degree}: give zero or more")
    nodes, fit = _nodes(torch.device("cpu"), degree)
    return nodes.clone(), fit.clone()


@remembered(32)
def _nodes(degree: int) -> tuple[Tensor, Tensor]:
    import scipy.linalg

    nodes, weights = gauss_legendre_hemisphere(2 * degree)
    # Columns are orthonormal under the rule.
    table = hemisphere_basis(nodes, degree + 1) * weights.sqrt()[:, None]
    # The rule is symmetric, so that many are as good as each other: the first of them, whatever rounding says.
    table = table * (1 - 1e-7 * torch.arange(len(table), dtype=table.dtype))[:, None]
    _, order = scipy.linalg.qr(table.mT.numpy(), mode="r", pivoting=True, check_finite=False)
    chosen = torch.from_numpy(order[: table.shape[1]].copy()).long().sort().values
    return nodes[chosen], torch.linalg.inv(hemisphere_basis(nodes[chosen], degree + 1))
