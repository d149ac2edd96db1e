"""Turning a light, and the rotation matrices of each band."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import bands, basis, only_values_are_wanted, order_of, values_are_at_hand
from torchprt.sh.constant import remembered
from torchprt.sh.euler import turn_by_euler
from torchprt.sh.precision import KeepsSingle, at_least_single, whole_rotation, widened, without_autocast
from torchprt.sh.quadrature import LARGEST_LEBEDEV_DEGREE, gauss_legendre, lebedev


@without_autocast
def rotate(light: Float[Tensor, "*#B N C"], rotation: Float[Tensor, "*#B 3 3"]) -> Float[Tensor, "... N C"]:
    """SH coefficients of an environment turned by `rotation`; leading dimensions broadcast.

    If `light` reconstructs to f(s), the result reconstructs to f(R^T s).
    Laws: rotate(l, I) = l; rotate(rotate(l, A), B) = rotate(l, B A); the norm of every band is kept.
    Exact up to rounding for every rotation; gradients flow to both arguments.

    Two ways to the same values. Where only values are wanted, three Euler turns (`turn_by_euler`): 2 to 60 times
    faster for many lights of order 6 to 32. Where a graph is traced or a gradient recorded, quadrature of degree
    2(n - 1), as in `Rotation`: a polynomial in the nine numbers of `rotation`, so without gimbal cases.

    What is narrower than float32 is turned in float32, also under autocast, and the result has the dtype of `light`; a
    rotation that was rounded to a narrow type is brought back to the nearest one first.
    Raises InputError if N is not a square number, if one is float64 and the other is not or, outside a traced graph, if
    `rotation` is not a proper rotation (see `check_rotation`). Inside a graph use `Rotation`, which holds its constants
    as buffers.
    Source: Sloan, Kautz and Snyder 2002, section 3, equation 4.
    """
    order = order_of(light.shape[-2])
    wide = at_least_single(light.dtype)
    if wide != at_least_single(rotation.dtype):
        raise InputError(f"light is {light.dtype} but rotation is {rotation.dtype}: convert one of them")
    check_rotation(rotation)
    exact, turn = light.to(wide), whole_rotation(rotation)
    if only_values_are_wanted(exact, turn):
        return turn_by_euler(exact, turn).to(light.dtype)
    return _turn(exact, turn, _constants(light.device, order, wide), order).to(light.dtype)


class Rotation(KeepsSingle):
    """`rotate` for lights of one order, its constants as buffers: for graphs that are compiled or exported.

    `forward(light [*B, N, C], rotation [*B, 3, 3]) -> [*B, N, C]`, plain operations only, the same ones whether
    a graph is traced or not; no check of `rotation`. The constants are float32 at least.
    Raises InputError if `order` is below 1, or light or rotation is float64 and the constants are not.
    """

    single = ("points", "parity", "project")
    points: Tensor
    parity: Tensor
    project: Tensor

    def __init__(self, order: int, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.order = order
        constants = _constants(torch.device("cpu"), order, at_least_single(dtype))
        for name, values in zip(self.single, constants, strict=True):
            self.register_buffer(name, values, persistent=False)

    def forward(self, light: Float[Tensor, "*#B N C"], rotation: Float[Tensor, "*#B 3 3"]) -> Float[Tensor, "... N C"]:
        wide = self.project.dtype
        for name, values in (("light", light), ("rotation", rotation)):
            if at_least_single(values.dtype) != wide:
                raise InputError(f"{name} is {values.dtype} but the constants of the rotation are {wide}: convert one")
        constants = (self.points, self.parity, self.project)
        return _turn(light.to(wide), whole_rotation(rotation), constants, self.order).to(light.dtype)


def check_rotation(rotation: Float[Tensor, "*B 3 3"], name: str = "rotation") -> None:
    """Raises InputError unless every matrix is orthogonal and proper (no reflection).

    Orthogonal within 1e-4, or within what a rotation loses that is rounded to a narrow type: 2 epsilons of it.
    Nothing is checked where values cannot be looked at: in a traced graph, under torch.func.
    """
    if not values_are_at_hand(rotation):
        return
    tolerance = max(1e-4, 2 * torch.finfo(rotation.dtype).eps)
    # Rotations last: nine long streams, many times faster than a thousand products and determinants of 3x3.
    rows = widened(rotation).reshape(-1, 9).T.contiguous().reshape(3, 3, -1)
    identity = torch.eye(3, dtype=rows.dtype, device=rows.device).unsqueeze(-1)
    if not bool(((rows.unsqueeze(1) * rows).sum(2) - identity).abs().le(tolerance).all()):
        within = "1e-4" if tolerance == 1e-4 else f"{tolerance:.2g}"
        raise InputError(f"{name} must be orthogonal within {within}: remove scale and shear, and non-finite values")
    if not bool((torch.linalg.cross(rows[0], rows[1], dim=0) * rows[2]).sum(0).gt(0).all()):
        raise InputError(f"{name} holds a reflection (determinant -1): give a proper rotation")


def yaw_pitch_roll(degrees: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3 3"]:
    """Rotation matrices Ry(yaw) Rx(pitch) Rz(roll) for column vectors, from angles in degrees."""
    radians = degrees * (math.pi / 180)
    (cy, cx, cz), (sy, sx, sz) = torch.cos(radians).unbind(-1), torch.sin(radians).unbind(-1)
    rows = [
        torch.stack([cy * cz + sy * sx * sz, sy * sx * cz - cy * sz, sy * cx], -1),
        torch.stack([cx * sz, cx * cz, -sx], -1),
        torch.stack([cy * sx * sz - sy * cz, sy * sz + cy * sx * cz, cy * cx], -1),
    ]
    return torch.stack(rows, -2)


@without_autocast
def _turn(light: Tensor, rotation: Tensor, constants: tuple[Tensor, Tensor, Tensor], order: int) -> Tensor:
    """The turned light at s is the light at R^T s: evaluate it there, project it back.

    The points cover half the sphere. Even and odd bands are evaluated apart, which is as good as the other half.
    """
    points, parity, project = constants
    channels, halves = light.shape[-1], parity.shape[-1]
    # (R^T s) for all rotations and points, components first.
    turned = (rotation.movedim(-1, 0) @ points.mT).movedim(0, -1)
    # Every channel once a half, then masked: a broadcast product with the halves last is seven times slower.
    parted = light.repeat_interleave(halves, -1) * parity.repeat(1, channels)
    values = parted.mT @ basis(turned, order).mT
    return (values.reshape(*values.shape[:-2], channels, halves * points.shape[0]) @ project).mT


@remembered(64)
def _constants(order: int, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """Points [D, 3], parity of the bands [N, halves], and what projects the values back [halves D, N]."""
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")
    degree = 2 * (order - 1)
    band = bands(order)
    if degree <= LARGEST_LEBEDEV_DEGREE:
        points, weights = lebedev(degree)
        # One of every two opposite points: the first coordinate of z, y, x that is not zero is positive.
        x, y, z = points.unbind(-1)
        kept = (z > 0) | ((z == 0) & ((y > 0) | ((y == 0) & (x > 0))))
        points, weights = points[kept], 2 * weights[kept]
        parity = torch.stack([band % 2 == 0, band % 2 == 1], -1).to(torch.float64)
    else:
        points, weights = gauss_legendre(degree)
        parity = torch.ones(order * order, 1, dtype=torch.float64)
    project = (parity.mT.unsqueeze(1) * (basis(points, order) * weights[:, None])).flatten(0, 1)
    return points.to(dtype), parity.to(dtype), project.to(dtype)
