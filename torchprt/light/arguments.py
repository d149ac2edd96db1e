"""What every analytic light takes and gives: directions, colours, angles, coloured zonal functions."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError
from torchprt.sh.basis import values_are_at_hand
from torchprt.sh.constant import remembered

Vector = Float[Tensor, "*#B 3"] | Sequence[float | int]
Colour = Float[Tensor, "*#B 3"] | Sequence[float | int] | float | int
Number = Float[Tensor, "*#B"] | float | int


def unit_and_colour(direction: Vector, radiance: Colour, name: str = "direction") -> tuple[Tensor, Tensor]:
    """Both as tensors of one dtype and device, that of the first which is a tensor, the direction of unit length.

    Raises InputError if the direction is zero or anything is not finite.
    """
    like = next((value for value in (direction, radiance) if isinstance(value, Tensor)), None)
    dtype, device = (torch.get_default_dtype(), None) if like is None else (like.dtype, like.device)
    vector, colour = (torch.as_tensor(value, dtype=dtype, device=device) for value in (direction, radiance))
    if vector.shape[-1:] != (3,):
        raise InputError(f"{name} must have three components, not shape {tuple(vector.shape)}")
    if colour.ndim == 0:
        colour = colour.expand(3)
    if colour.shape[-1:] != (3,):
        raise InputError(f"a colour must be one number or three, not shape {tuple(colour.shape)}")
    # Squares of very long and very short vectors leave the range of floats.
    largest = vector.detach().abs().amax(-1, keepdim=True)
    check(name, vector, (largest > 0) & largest.isfinite(), "must be finite and not zero")
    check("the colour of the light", colour, colour.isfinite(), "must be finite")
    scaled = vector / largest
    return scaled / torch.linalg.vector_norm(scaled, dim=-1, keepdim=True), colour


def length(vector: Tensor) -> Tensor:
    largest = vector.detach().abs().amax(-1, keepdim=True)
    return torch.linalg.vector_norm(vector / largest, dim=-1) * largest[..., 0]


def check_order(order: int) -> None:
    if order < 1:
        raise InputError(f"order must be at least 1, not {order}")


def as_double(value: Vector | Number, like: Tensor) -> Tensor:
    # The solid angle of a small disc is below the range of float32.
    return torch.as_tensor(value, dtype=torch.float64, device=like.device)


def check(name: str, value: Tensor, good: Tensor, wanted: str) -> None:
    if values_are_at_hand(value, good) and not bool(good.all()):
        raise InputError(f"{name} {wanted}, not {value.detach().tolist()}")


@remembered(32)
def clamped_cosine(order: int, dtype: torch.dtype) -> Float[Tensor, " n"]:
    """`sh.clamped_cosine`, kept, on a device."""
    return sh.clamped_cosine(order, dtype=dtype)


def zonal_light(
    axis: Float[Tensor, "*#B 3"], bands: Float[Tensor, "*#B n"], colour: Float[Tensor, "*#B 3"]
) -> Float[Tensor, "... N 3"]:
    """The light of `colour` times the function with zonal coefficients `bands` (A_l form) about `axis`."""
    function = sh.zonal(bands.double(), axis.double())
    return (function[..., :, None] * colour.double()[..., None, :]).to(axis.dtype)
