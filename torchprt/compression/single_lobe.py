"""One zonal lobe: its best coefficients in closed form, its best axis by search."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.compression.lobe_refinement import Workers
from torchprt.sh import bands, basis, cube_directions, order_of
from torchprt.sh.constant import remembered

# Texels along the edge of the hemicube whose centres are tried as axes.
_TEXELS = 12


def lobe_coefficients(vectors: Float[Tensor, "*#V N"], axis: Float[Tensor, "*#V 3"]) -> Float[Tensor, "... n"]:
    """The coefficients `g*_l` of the lobe about `axis` that is nearest to each of `vectors`.

    `sh.zonal(g, axis)` are the SH coefficients of the lobe; what it leaves of a vector is orthogonal to it in every
    band. `axis` has unit length (not checked); leading dimensions broadcast; gradients flow to both.
    Raises InputError if N is not a square number.
    Source: Sloan, Luna and Snyder 2005, equation 18 (whose lower limit -1 is a misprint for -l).
    """
    order = order_of(vectors.shape[-1])
    products = vectors * basis(axis, order)
    band = bands(order).to(products.device)
    sums = products.new_zeros(*products.shape[:-1], order).index_add(-1, band, products)
    return sums * (4 * math.pi / (2 * torch.arange(order, device=products.device, dtype=sums.dtype) + 1))


def linear_axis(vectors: Float[Tensor, "*V N"]) -> Float[Tensor, "*V 3"]:
    """The optimal linear axis of each of `vectors`: the one about which a single lobe has the linear band exactly.

    (0, 0, 1) for a vector whose linear band is zero. Raises InputError if N is not a square number, or 1.
    Source: Sloan, Luna and Snyder 2005, section 3.3.
    """
    if order_of(vectors.shape[-1]) < 2:
        from torchprt.errors import InputError

        raise InputError("vectors have one coefficient: the linear axis is that of band 1, give an order of 2 or more")
    linear = vectors[..., [3, 1, 2]] * vectors.new_tensor([-1.0, -1.0, 1.0])
    # Scaled first: the squares of numbers of any size must neither vanish nor overflow.
    size = linear.abs().amax(-1, keepdim=True)
    unit = torch.nn.functional.normalize(linear / torch.where(size > 0, size, 1.0), dim=-1, eps=0.5)
    return torch.where(size > 0, unit, vectors.new_tensor([0.0, 0.0, 1.0]))


@remembered(1)
def hemicube() -> Float[Tensor, "D 3"]:
    """Directions of which none is opposite to another: lobes about opposite axes are the same."""
    return cube_directions(_TEXELS)[[0, 2, 4]].reshape(-1, 3)


def best_axis(vectors: Tensor, first: int, workers: Workers) -> Tensor:
    """The axis `[3, V]` of the single lobe nearest to `vectors [N, C, V]` from band `first` on, channels together.

    Of the hemicube and the optimal linear axis, not refined.
    """
    directions = hemicube(vectors.device).to(vectors)
    order = math.isqrt(len(vectors))
    table = basis(directions, order)

    def work(rows: slice) -> Tensor:
        some = vectors[..., rows]
        gain = some.new_zeros(len(directions), some.shape[-1])
        for l in range(first, order):
            band = slice(l * l, (l + 1) ** 2)
            along = (table[:, band] @ some[band].flatten(1)).unflatten(1, some.shape[1:])
            gain += along.square().sum(1) * (4 * math.pi / (2 * l + 1))
        best, which = gain.max(0)
        axis = directions[which].T
        if first > 1:
            return axis
        linear = linear_axis(some.sum(1).T)
        about = basis(linear, order).movedim(-1, 0)
        gains = [
            (about[l * l : (l + 1) ** 2, None] * some[l * l : (l + 1) ** 2]).sum(0).square().sum(0)
            * (4 * math.pi / (2 * l + 1))
            for l in range(first, order)
        ]
        return torch.where(torch.stack(gains).sum(0) > best, linear.T, axis)

    return torch.cat(workers.map(work, vectors.shape[-1]), -1)
