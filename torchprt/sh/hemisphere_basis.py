"""An orthonormal basis of the hemisphere z > 0 that spans the spherical harmonics there."""

import functools
import math
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import basis, only_values_are_wanted, plain_recurrence
from torchprt.sh.constant import remembered
from torchprt.sh.hemisphere import DISCARDED
from torchprt.sh.precision import widened

Projection = Literal["optimal", "reduced", "zero", "odd", "even"]


def hemisphere_basis(directions: Float[Tensor, "*D 3"], order: int) -> Float[Tensor, "*D N"]:
    """Functions h_lm, l < `order`, orthonormal on the hemisphere z > 0, at unit `directions`; index i = l(l + 1) + m.

    Together they span what the spherical harmonics of that order span there, and so do the first n of each m. The
    least-squares optimal coefficients of a function f are therefore the plain integrals `int_H f h_i`, and the
    squared norm of coefficients is that of the function: no inverse Gram matrix, whose condition (1.5e5 at order 5,
    3.5e9 at order 8) costs more digits than float32 has. `A^-1 b` of `hemisphere_projection` is the same function.
    The signs are those of `basis`. Below the horizon the polynomials go on and mean nothing.

    As `basis`: a view of memory with components first, a recurrence without angles, gradients finite everywhere.
    Raises InputError if `order` is below 1.
    Source: the projection of Sloan, Hall, Hart and Snyder 2003, section 9, in a basis of our own: for each m the
    polynomials orthogonal on 0 < z < 1 with the weight (1 - z^2)^m.
    """
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    wide = widened(directions)
    tables = _tables(directions.device, order, wide.dtype)
    build = _in_place if only_values_are_wanted(directions) else _functional
    components = build(wide.reshape(-1, 3).T.contiguous(), tables, order).to(directions.dtype)
    return components.reshape(order * order, *directions.shape[:-1]).movedim(0, -1)


def exit_functions(
    directions: Float[Tensor, "*D 3"], order: int, projection: Projection = "optimal"
) -> Float[Tensor, "*D M"]:
    """The functions of the local exit direction that stand for exit radiance under a projection.

    "optimal": `hemisphere_basis`; "zero", "odd", "even": `basis`; "reduced": `basis` without l = 1, m = 0.
    Raises InputError if `order` is below 1 or `projection` is unknown.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3.2 and 9.
    """
    count = exit_count(order, projection)
    if projection == "optimal":
        return hemisphere_basis(directions, order)
    values = basis(directions, order)
    if count == order * order:
        return values
    return torch.cat([values[..., :DISCARDED], values[..., DISCARDED + 1 :]], -1)


def exit_count(order: int, projection: Projection = "optimal") -> int:
    """How many `exit_functions` there are: `order`^2, one less if "reduced" (from order 2).

    Raises InputError if `order` is below 1 or `projection` is unknown.
    """
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    if projection not in ("optimal", "reduced", "zero", "odd", "even"):
        raise InputError(f"projection '{projection}' is unknown: use 'optimal', 'reduced', 'zero', 'odd' or 'even'")
    return order * order - (1 if projection == "reduced" and order > 1 else 0)


def exit_recurrence(order: int, projection: Projection = "optimal") -> tuple[Tensor, Tensor]:
    """What a shader evaluates `exit_functions` with: slope, level and across `[N, 3]` of every index l(l + 1) + m, and
    `sectoral [order]`, float64. With e_00 = sectoral_0 and, in the local direction (x, y, z),

    - e_lm = (slope z + level) e_(l-1)m - across e_(l-2)m for |m| < l,
    - e_l-l = sectoral_l (x e_(l-1)-(l-1) + y e_(l-1)(l-1)), e_ll = sectoral_l (x e_(l-1)(l-1) - y e_(l-1)-(l-1)); at
      l = 1 without e_(l-1)-(l-1).

    Of "reduced" it gives all N, with l = 1, m = 0, which is no exit function of it.
    Raises InputError as `exit_functions` does.
    """
    exit_count(order, projection)
    if projection == "optimal":
        *columns, sectoral = _recurrence(order)
        return torch.tensor(columns, dtype=torch.float64).T, torch.tensor(sectoral, dtype=torch.float64)
    along, across = plain_recurrence(order, torch.float64)
    heads = [math.sqrt(0.25 / math.pi), -math.sqrt(3.0), *(-math.sqrt((2 * l + 1) / (2 * l)) for l in range(2, order))]
    table = torch.stack([along, torch.zeros_like(along), across], -1)[:, 0]
    return table, torch.tensor(heads[:order], dtype=torch.float64)


def to_horizon(directions: Float[Tensor, "*D 3"]) -> Float[Tensor, "*D 3"]:
    """Local directions brought to unit length and, where they point below the horizon, up to it.

    Vertices at a silhouette have smooth normals that look away from the eye a little: what they show is what they show
    at the horizon. Zero, and straight down, become the normal (0, 0, 1). Finite gradients everywhere.
    """
    above = directions.clamp(min=directions.new_tensor([-torch.inf, -torch.inf, 0]))
    # Scaled first: the squares of tiny components would vanish.
    largest = above.abs().amax(-1, keepdim=True)
    nothing = largest == 0
    scaled = torch.where(nothing, directions.new_tensor([0.0, 0.0, 1.0]), above / torch.where(nothing, 1.0, largest))
    # `vector_norm` is a hundred times slower where components come first in memory.
    return scaled / scaled.square().sum(-1, keepdim=True).sqrt()


def _functional(xyz: Tensor, tables: tuple[Tensor, ...], order: int) -> Tensor:
    x, y, z = xyz
    slope, level, across, sectoral = tables
    bands = [sectoral[:1] * torch.ones_like(xyz[:1])]
    for l in range(1, order):
        last = bands[l - 1]
        inner = slice(l * l + 1, (l + 1) ** 2 - 1)
        risen = last * (slope[inner] * z + level[inner])
        if l > 1:
            held = across[l * l + 2 : (l + 1) ** 2 - 2] * bands[l - 2]
            risen = torch.cat([risen[:1], risen[1:-1] - held, risen[-1:]])
        sine, cosine = (last[:1] if l > 1 else torch.zeros_like(last)), last[-1:]
        lowest, highest = x * sine + y * cosine, x * cosine - y * sine
        bands.append(torch.cat([lowest * sectoral[l], risen, highest * sectoral[l]]))
    return torch.cat(bands)


def _in_place(xyz: Tensor, tables: tuple[Tensor, ...], order: int) -> Tensor:
    """`_functional` written straight into the result, without gradients."""
    x, y, z = xyz
    slope, level, across, sectoral = tables
    rows = xyz.new_empty(order * order, xyz.shape[1])
    rows[0] = sectoral[0]
    for l in range(1, order):
        start, end = l * l, (l + 1) ** 2
        inner = slice(start + 1, end - 1)
        last = rows[(l - 1) ** 2 : start]
        torch.mul(slope[inner], z, out=rows[inner]).add_(level[inner]).mul_(last)
        if l > 1:
            rows[start + 2 : end - 2].addcmul_(across[start + 2 : end - 2], rows[(l - 2) ** 2 : (l - 1) ** 2], value=-1)
        torch.mul(y, last[-1], out=rows[start])
        torch.mul(x, last[-1], out=rows[end - 1])
        if l > 1:
            rows[start].addcmul_(x, last[0])
            rows[end - 1].addcmul_(y, last[0], value=-1)
        rows[start].mul_(sectoral[l])
        rows[end - 1].mul_(sectoral[l])
    return rows


@remembered(64)
def _tables(order: int, dtype: torch.dtype) -> tuple[Tensor, ...]:
    return tuple(torch.tensor(table, dtype=dtype).unsqueeze(-1) for table in _recurrence(order))


@functools.lru_cache(maxsize=64)
def _recurrence(order: int) -> tuple[tuple[float, ...], ...]:
    """slope, level, across of h_lm = (slope z + level) h_(l-1)m - across h_(l-2)m for every index, and by band the
    factor of h_mm = sectoral (x h_(m-1)(m-1) - y h_(m-1)-(m-1)); its first entry is h_00."""
    # Stieltjes' procedure with a rule that is exact for z^2 p_k^2 (1 - z^2)^m.
    nodes, weights = np.polynomial.legendre.leggauss(order + 1)
    z, weights = (nodes + 1) / 2, weights / 2
    slope, level, across = ([0.0] * order**2 for _ in range(3))
    heads = []
    for m in range(order):
        weight = weights * ((1 - z) * (1 + z)) ** m
        heads.append(1 / math.sqrt((2 if m == 0 else 1) * math.pi * weight.sum()))
        before, last, norm = np.zeros_like(z), np.full_like(z, 1 / math.sqrt(weight.sum())), 0.0
        for l in range(m + 1, order):
            middle = float((weight * z * last * last).sum())
            following = (z - middle) * last - norm * before
            size = math.sqrt(float((weight * following * following).sum()))
            for index in {l * (l + 1) - m, l * (l + 1) + m}:
                slope[index], level[index], across[index] = 1 / size, -middle / size, norm / size
            before, last, norm = last, following / size, size
    # The sign of odd m alternates, and h_11 = sectoral x h_00.
    sectoral = [heads[0], *(-heads[m] / heads[m - 1] for m in range(1, order))]
    return tuple(slope), tuple(level), tuple(across), tuple(sectoral)
