"""Coefficients in the conventions of other packages and back.

D3DX, DirectXMath and 3D Gaussian splatting share ours: nothing to convert.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.basis import order_of
from torchprt.sh.matrices import rotation_matrix

# e3nn takes its pole along +y: it evaluates the sign-free basis at (z, x, y).
_E3NN_AXES = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def to_sign_free(light: Float[Tensor, "*B N C"]) -> Float[Tensor, "*B N C"]:
    """Coefficients for the real orthonormal basis without the Condon-Shortley sign (sphericart).

    Raises InputError if N is not a square number.
    """
    order = order_of(light.shape[-2])
    signs = [(-1.0) ** m for l in range(order) for m in range(-l, l + 1)]
    return light * torch.tensor(signs, dtype=light.dtype, device=light.device).unsqueeze(-1)


def from_sign_free(light: Float[Tensor, "*B N C"]) -> Float[Tensor, "*B N C"]:
    """The inverse of `to_sign_free`, which is its own inverse."""
    return to_sign_free(light)


def to_e3nn(light: Float[Tensor, "*B N C"]) -> Float[Tensor, "*B N C"]:
    """Coefficients of the same function of the same directions for e3nn's basis, normalisation "integral".

    Raises InputError if N is not a square number.
    """
    return to_sign_free(_e3nn_axes(light) @ light)


def from_e3nn(light: Float[Tensor, "*B N C"]) -> Float[Tensor, "*B N C"]:
    """The inverse of `to_e3nn`. Raises InputError if N is not a square number."""
    return _e3nn_axes(light).mT @ from_sign_free(light)


def to_pyshtools(light: Float[Tensor, "*B N C"]) -> Float[Tensor, "*B C 2 n n"]:
    """pyshtools' arrays cilm [cosine or sine, l, m] a channel: normalization "ortho", csphase 1, kind "real".

    Raises InputError if N is not a square number.
    """
    order = order_of(light.shape[-2])
    part, band, degree = _cilm_index(order, light.device)
    cilm = light.new_zeros(*light.shape[:-2], light.shape[-1], 2, order, order)
    cilm[..., part, band, degree] = to_sign_free(light).mT
    return cilm


def from_pyshtools(cilm: Float[Tensor, "*B C 2 n n"]) -> Float[Tensor, "*B N C"]:
    """The inverse of `to_pyshtools`. Raises InputError if `cilm` has no band."""
    order = cilm.shape[-1]
    if order < 1:
        raise InputError("cilm is empty: it needs at least band 0")
    part, band, degree = _cilm_index(order, cilm.device)
    return from_sign_free(cilm[..., part, band, degree].mT)


def _e3nn_axes(light: Tensor) -> Tensor:
    axes = torch.tensor(_E3NN_AXES, dtype=torch.float64, device=light.device)
    return rotation_matrix(axes, order_of(light.shape[-2])).to(light.dtype)


def _cilm_index(order: int, device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    index = [(int(m < 0), l, abs(m)) for l in range(order) for m in range(-l, l + 1)]
    part, band, degree = torch.tensor(index, device=device).unbind(-1)
    return part, band, degree
