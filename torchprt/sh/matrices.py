"""The rotation matrices of each band, built from the 3x3 rotation without angles."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.constant import remembered
from torchprt.sh.precision import at_least_single, whole_rotation, without_autocast

# From here on the recurrence runs in float64 even for float32 input.
_LAST_FLOAT32_ORDER = 20


@without_autocast
def rotation_bands(rotation: Float[Tensor, "*B 3 3"], order: int) -> tuple[Float[Tensor, "*B rows columns"], ...]:
    """The matrix D_l(R) of every band l < `order`, `[*B, 2l + 1, 2l + 1]`: y_l(R s) = D_l(R) y_l(s).

    Laws: D(A B) = D(A) D(B), D(R^T) = D(R)^T. Polynomial in the nine numbers of `rotation`, so there is no
    gimbal case and gradients are right everywhere, the identity included. float32 input above order 20 is
    computed in float64 and rounded once at the end; a rotation of a narrow type is brought back to the nearest one.

    Raises InputError if `order` is below 1. `rotation` is not checked (see `check_rotation`).
    Source: Ivanic and Ruedenberg 1996, "Rotation matrices for real spherical harmonics", with the 1998
    errata, their u, v, w and P gathered into one constant matrix per band.
    """
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    dtype = rotation.dtype
    exact = at_least_single(dtype) if order <= _LAST_FLOAT32_ORDER else torch.float64
    # Rotations last: every band is then one matrix product with a constant on the left.
    turn = whole_rotation(rotation).reshape(-1, 3, 3).movedim(0, -1).to(exact)
    bands = [torch.ones_like(turn[:1, :1])]
    for l in range(1, order):
        couple, inner, outer = _coupling(rotation.device, l, exact)
        last = bands[-1]
        x, y, z = (turn[:, axis, None, None] for axis in range(3))
        # The outermost columns come from (x + iy) times the outermost of the band below.
        low, high = last[:, :1] * outer, last[:, -1:] * outer
        lowest, highest = (-y * high, -x * high) if l == 1 else (-(x * low + y * high), y * low - x * high)
        risen = torch.cat([lowest, z * (last * inner), highest], -2)
        bands.append((couple @ risen.reshape(couple.shape[1], -1)).reshape(2 * l + 1, 2 * l + 1, -1))
    shape = rotation.shape[:-2]
    return tuple(band.movedim(-1, 0).reshape(*shape, *band.shape[:2]).to(dtype) for band in bands)


def rotation_matrix(rotation: Float[Tensor, "*B 3 3"], order: int) -> Float[Tensor, "*B N N"]:
    """All bands of `rotation_bands` in one block-diagonal matrix: `D @ light` turns a light.

    `rotate` does the same many times faster; this is for when the matrix itself is wanted.
    Raises InputError if `order` is below 1. `rotation` is not checked (see `check_rotation`).
    """
    pad = torch.nn.functional.pad
    bands = rotation_bands(rotation, order)
    return torch.cat([pad(band, (l * l, order * order - (l + 1) ** 2)) for l, band in enumerate(bands)], dim=-2)


@remembered(256)
def _coupling(l: int, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """int y_lm s_j y_(l-1)k as a matrix [2l + 1, 3 (2l - 1)], and what divides it out again.

    z y_(l-1)m = a y_lm + ..., and (x + iy) times the outermost y_(l-1) is 1 / outer times the outermost y_l.
    """
    size = 2 * l - 1
    table = [[0.0] * (3 * size) for _ in range(2 * l + 1)]
    inner = []
    norm = (2 * l - 1) * (2 * l + 1)

    def add(m: int, axis: int, k: int, value: float) -> None:
        if abs(k) < l:
            table[m + l][axis * size + k + l - 1] += value

    for m in range(-l, l + 1):
        size_of_m = abs(m)
        if size_of_m < l:
            along = math.sqrt((l - size_of_m) * (l + size_of_m) / norm)
            add(m, 2, m, along)
            inner.append(1 / along)
        # Without the sqrt(2) of the real basis, raising and lowering |m| by x + iy.
        raised = -0.5 * math.sqrt((l + size_of_m) * (l + size_of_m - 1) / norm)
        lowered = 0.5 * math.sqrt((l - size_of_m) * (l - size_of_m - 1) / norm)
        if m == 0:
            # Only |k| = 1 reaches m = 0, and y_l0 lacks the sqrt(2).
            add(0, 0, 1, math.sqrt(2) * lowered)
            add(0, 1, -1, math.sqrt(2) * lowered)
            continue
        root = math.sqrt(2) if size_of_m == 1 else 1.0
        if m > 0:
            add(m, 0, m - 1, root * raised)
            add(m, 0, m + 1, lowered)
            if m > 1:
                add(m, 1, -(m - 1), -raised)
            add(m, 1, -(m + 1), lowered)
        else:
            k = size_of_m
            add(m, 1, k - 1, root * raised)
            add(m, 1, k + 1, -lowered)
            if k > 1:
                add(m, 0, -(k - 1), raised)
            add(m, 0, -(k + 1), lowered)
    outer = math.sqrt((2 * l + 1) / (2 * l)) * (math.sqrt(2) if l == 1 else 1.0)
    return (
        torch.tensor(table, dtype=dtype),
        torch.tensor(inner, dtype=dtype).reshape(1, -1, 1),
        torch.tensor(outer, dtype=dtype),
    )
