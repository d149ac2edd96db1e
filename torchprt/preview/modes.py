"""What a vertex can be lit by beside its transfer: the ways that look at its normal alone."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.light.dominant import dominant
from torchprt.transfer import Transfer


def reflectance(transfer: Transfer) -> Float[Tensor, "V 3"]:
    """The weights of all layers of every receiver, at most 1: its colour without its gloss."""
    weights = torch.zeros(transfer.vertices, 3)
    for layer in transfer.layers.values():
        index = layer.index(transfer.vertices)
        weights[index] += layer.weight.float().expand(len(index), 3)
    return weights.clamp(max=1)


def unshadowed(light: Float[Tensor, "N 3"], normals: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
    """Radiance of white diffuse surfaces that nothing shadows: irradiance / pi.

    Source: Ramamoorthi and Hanrahan 2001, "An efficient representation for irradiance environment maps", equation 7.
    """
    order = math.isqrt(len(light))
    irradiance = sh.convolve(light, sh.clamped_cosine(order, dtype=light.dtype))
    return sh.basis(normals.to(light.dtype), order) @ irradiance / math.pi


def one_lamp(light: Float[Tensor, "N 3"], normals: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
    """Radiance of white diffuse surfaces under `light.dominant` alone, N . L: no shadow, and black away from it."""
    direction, radiance = dominant(light)
    return (normals.to(light.dtype) @ direction).clamp(min=0)[:, None] * radiance
