"""Turning lights by three Euler turns, about z, y and z: the fast way where only values are wanted."""

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh.basis import bands, order_of
from torchprt.sh.constant import remembered
from torchprt.sh.matrices import rotation_bands
from torchprt.sh.shapes import broadcast_shapes

# Up to here one product with J, zeros and all, is as fast as a product a band.
_LAST_DENSE_ORDER = 4


def turn_by_euler(light: Float[Tensor, "*#B N C"], rotation: Float[Tensor, "*#B 3 3"]) -> Float[Tensor, "... N C"]:
    """The light turned by R = Rz(a) Ry(b) Rz(c), as D(R) = Z(a) J Z(-b) J Z(c); leading dimensions broadcast.

    Z(a) mixes m and -m by the real and imaginary parts of e^(ima). J, which swaps y and z, is a constant matrix a
    band. Values are exact up to rounding for every rotation; there are no gradients: at b = 0 and 180 degrees (so
    at the identity) the angles have none. `rotation` is not checked.

    Raises InputError if N is not a square number.
    Source: Pinchon and Hoggan 2007, "Rotation matrices for real spherical harmonics: general rotations of atomic
    orbitals in space-fixed axes".
    """
    order, batch = order_of(light.shape[-2]), broadcast_shapes(light.shape[:-2], rotation.shape[:-2])
    swap, mirrored, size_of_m, sine_of_m = _constants(light.device, order, light.dtype)
    rotation = rotation.reshape(*[1] * (len(batch) + 2 - rotation.ndim), *rotation.shape)
    powers = _powers(_euler(_batch_last(rotation)), order)
    # Two buffers, written in turns: fresh memory and caches overrun cost more than the arithmetic.
    turned = _batch_last(light.expand(*batch, *light.shape[-2:]))
    mixed = torch.empty_like(turned)
    for turn in range(3):
        if turn > 0:
            rows, results = (side.view(order**2, -1).split([len(block) for block in swap]) for side in (mixed, turned))
            for block, row, result in zip(swap, rows, results, strict=True):
                torch.mm(block, row, out=result)
        cosines, sines = powers[turn].real.contiguous(), powers[turn].imag
        cosine = cosines.index_select(0, size_of_m).unsqueeze(1)
        sine = torch.cat([sines, -sines]).index_select(0, sine_of_m).unsqueeze(1)
        torch.index_select(turned, 0, mirrored, out=mixed).mul_(sine).addcmul_(cosine, turned)
    return mixed.movedim((0, 1), (-2, -1)).contiguous()


def _batch_last(tensor: Tensor) -> Tensor:
    """A copy `[rows, columns, *B]` of `[*B, rows, columns]`: every entry is one contiguous stream."""
    *batch, rows, columns = tensor.shape
    streams = tensor.reshape(-1, rows * columns).T.clone(memory_format=torch.contiguous_format)
    return streams.view(rows, columns, *batch)


def _euler(rotation: Tensor) -> Tensor:
    """e^(it) `[3, *B]` of the turns c, -b and a in Rz(a) Ry(b) Rz(c) = `rotation [3, 3, *B]`."""
    x, y, z = rotation[:, 2]
    distance = torch.hypot(x, y)
    # At the poles a is free: 0. Below eps^2 the quotients could underflow, and the light would not move.
    pole = distance < torch.finfo(rotation.dtype).eps ** 2
    cosine, sine = torch.where(pole, 1, x / distance), torch.where(pole, 0, y / distance)
    # c from what a leaves, not from the last row: near the poles the errors of a and c then cancel.
    (r00, r01, _), (r10, r11, _), _ = rotation
    real = torch.stack([cosine * r11 - sine * r01, z, cosine])
    return torch.complex(real, torch.stack([cosine * r10 - sine * r00, -distance, sine]))


def _powers(unit: Tensor, order: int) -> Tensor:
    """`unit` to the powers m < `order`, `[3, order, *B]`, each a product of two: errors grow as m eps, no faster."""
    powers = torch.stack([torch.ones_like(unit), unit], 1)
    while (count := powers.shape[1]) < order:
        powers = torch.cat([powers, powers[:, 1 : 1 + order - count] * powers[:, -1:]], 1)
    return powers[:, :order]


@remembered(64)
def _constants(order: int, dtype: torch.dtype) -> tuple[tuple[Tensor, ...], Tensor, Tensor, Tensor]:
    """J, in blocks; where -m stands; the rows of |m| in the cosines, and of its signed sine in [sines, -sines]."""
    exchange = torch.tensor([[1, 0, 0], [0, 0, 1], [0, 1, 0]], dtype=torch.float64)
    blocks = rotation_bands(exchange, order)
    swap = (torch.block_diag(*blocks[:_LAST_DENSE_ORDER]), *blocks[_LAST_DENSE_ORDER:])
    band = bands(order)
    centre = band * (band + 1)
    m = torch.arange(order**2) - centre
    sine_of_m = torch.where(m > 0, order + m, -m)
    return (
        tuple(block.to(dtype) for block in swap),
        centre - m,
        m.abs(),
        sine_of_m,
    )
