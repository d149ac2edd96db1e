"""Mirrors as a window draws them: each vertex has the colour of what surrounds the scene, in the direction it shows."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.preview.environment import seen_along


def mirror_radiance(
    mirrors: tuple[Tensor, Tensor, Tensor, Tensor],
    eye: Float[Tensor, "3"],
    image: Float[Tensor, "H W 3"],
    rotation: Float[Tensor, "3 3"],
) -> Float[Tensor, "P 3"]:
    """What the vertices of `mirrors` (`Vertices.mirrors`) show of an environment turned by `rotation`, linear.

    The environment alone: the scene itself is not in it, for which `Still` follows rays. Reflectance as
    `trace.Mirrors`. Source: Sloan, Kautz and Snyder 2002, figure 9.
    """
    positions, normals, reflectance, _ = mirrors
    toward = normalize(eye.to(positions.dtype) - positions, dim=-1)
    cosine = (toward * normals.to(toward)).sum(-1, keepdim=True)
    reflected = 2 * cosine * normals.to(toward) - toward
    share = reflectance + (1 - reflectance) * (1 - cosine.abs().clamp(max=1)).to(reflectance) ** 5
    found: Tensor = share * seen_along(image, reflected, rotation.to(reflected)).to(share)
    return found
