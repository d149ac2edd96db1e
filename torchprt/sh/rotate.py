"""Turning a light, and the rotation matrices of each band."""

import functools
import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import basis, order_of
from torchprt.sh.quadrature import gauss_legendre


def rotate(light: Float[Tensor, "*#B N C"], rotation: Float[Tensor, "*#B 3 3"]) -> Float[Tensor, "... N C"]:
    """SH coefficients of an environment turned by `rotation`; leading dimensions broadcast.

    If `light` reconstructs to f(s), the result reconstructs to f(R^T s).
    Laws: rotate(l, I) = l; rotate(rotate(l, A), B) = rotate(l, B A); the norm of every band is kept.
    Exact up to rounding (quadrature of degree 2(n - 1)), without angles, so without gimbal cases;
    gradients flow to both arguments.

    Raises InputError if N is not a square number or, outside a traced graph, if `rotation` is not a proper
    rotation within 1e-4. Inside a graph use `Rotation`, which holds its constants as buffers.
    Source: Sloan, Kautz and Snyder 2002, section 3, equation 4.
    """
    order = order_of(light.shape[-2])
    if not torch.compiler.is_compiling():
        check_rotation(rotation)
    points, project = _constants(order, light.dtype, light.device)
    return _turn(light, rotation, points, project, order)


class Rotation(torch.nn.Module):
    """`rotate` for lights of one order with its constants as buffers: for modules that are compiled or exported.

    `forward(light [*B, N, C], rotation [*B, 3, 3]) -> [*B, N, C]`, plain operations only, no check of
    `rotation`.
    Raises InputError if `order` is below 1.
    """

    points: Tensor
    project: Tensor

    def __init__(self, order: int, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        points, project = _build_constants(order, dtype, torch.device("cpu"))
        self.order = order
        self.register_buffer("points", points, persistent=False)
        self.register_buffer("project", project, persistent=False)

    def forward(self, light: Float[Tensor, "*#B N C"], rotation: Float[Tensor, "*#B 3 3"]) -> Float[Tensor, "... N C"]:
        return _turn(light, rotation, self.points, self.project, self.order)


def check_rotation(rotation: Float[Tensor, "*B 3 3"], name: str = "rotation") -> None:
    """Raises InputError unless every matrix is orthogonal within 1e-4 and proper (a reflection is refused)."""
    identity = torch.eye(3, dtype=rotation.dtype, device=rotation.device)
    if not bool((rotation @ rotation.mT - identity).abs().le(1e-4).all()):
        raise InputError(f"{name} must be orthogonal within 1e-4: remove scale and shear, and non-finite values")
    if not bool(torch.linalg.det(rotation).gt(0).all()):
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


def _turn(light: Tensor, rotation: Tensor, points: Tensor, project: Tensor, order: int) -> Tensor:
    # The turned light at direction s is the light at R^T s, and s^T R is its transpose.
    return project @ (basis(points @ rotation, order) @ light)


@torch.compiler.assume_constant_result
def _constants(order: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    build = _build_constants if torch.compiler.is_compiling() else _cached_constants
    return build(order, dtype, device)


def _build_constants(order: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    points, weights = gauss_legendre(2 * (order - 1))
    project = (basis(points, order) * weights[:, None]).T.contiguous()
    return points.to(device, dtype), project.to(device, dtype)


_cached_constants = functools.lru_cache(maxsize=64)(_build_constants)
