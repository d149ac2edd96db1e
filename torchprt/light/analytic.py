"""Lights with a formula: directional, disc, sphere, hemisphere, constant.

The reading of a light is the exit radiance it gives an unshadowed white diffuse surface, `irradiance / pi`.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.light.arguments import (
    Colour,
    Number,
    Vector,
    as_double,
    check,
    check_order,
    clamped_cosine,
    length,
    unit_and_colour,
    zonal_light,
)
from torchprt.sh.basis import band_of


def directional(
    direction: Vector, radiance: Colour = 1.0, *, order: int, normalise: bool = True
) -> Float[Tensor, "... N 3"]:
    """A distant point of light: `light_i = factor * radiance * y_i(direction)`.

    `radiance` is the reading of a surface that faces the light: exactly, at this very order, when normalised
    (factor `pi / sum_l A_l (2l + 1) / 4 pi`: 4 pi / 3, 16 pi / 17, 16 pi / 17, 32 pi / 31 for orders 2 to 5,
    as D3DXSHEvalDirectionalLight), otherwise only in the limit of high order (factor pi: a delta function of
    irradiance pi * `radiance`, which reads 17/16 of it at order 3).

    `direction` points toward the light, of any length but 0. Batch dimensions broadcast; gradients flow.
    Raises InputError if `direction` is zero or not finite, or `radiance` is not finite.
    Source: D3DXSHEvalDirectionalLight, and XMSHEvalDirectionalLight of DirectXMath.
    """
    axis, colour = unit_and_colour(direction, radiance)
    # A delta function of irradiance pi has all bands pi.
    bands = torch.full((order,), math.pi, dtype=torch.float64, device=axis.device)
    if normalise:
        bands = bands / (_facing(bands) / math.pi)
    return zonal_light(axis, bands, colour)


def disc(
    direction: Vector, half_angle: Number, radiance: Colour, order: int, *, normalise: bool = False
) -> Float[Tensor, "... N 3"]:
    """A disc in the sky (a cone of light): `radiance` within `half_angle` radians of `direction`, else 0.

    A surface that faces it reads `radiance * sin(half_angle)^2` (to 90 degrees), in the limit of high order.
    With `normalise` it reads `radiance` exactly, at this very order, so that a small disc tends to
    `directional`. D3DXSHEvalConeLight divides by `sin(min(half_angle, pi/2))^2` instead, which normalises the
    untruncated disc: its reading at order 3 tends to 17/16 and jumps to 1 below 1e-4 radians.

    Closed form, as stable at 1e-12 radians as at 1; directions and batches as in `directional`.
    Raises InputError also unless 0 < `half_angle` <= pi.
    """
    axis, colour = unit_and_colour(direction, radiance)
    angle = as_double(half_angle, axis)
    check("half_angle", angle, (angle > 0) & (angle <= math.pi + 1e-6), "must be above 0 and at most pi")
    bands = sh.disc(angle.clamp(max=math.pi), order)
    if normalise:
        bands = bands / (_facing(bands) / math.pi)[..., None]
    return zonal_light(axis, bands, colour)


def sphere(center: Vector, radius: Number, radiance: Colour, order: int) -> Float[Tensor, "... N 3"]:
    """A sphere that emits `radiance`, seen from the origin: a disc of half angle `asin(radius / |center|)`.

    Never normalised, as D3DXSHEvalSphericalLight: a surface that faces it reads, in the limit of high order,
    `radiance * (radius / |center|)^2`, which falls with the square of the distance.

    Raises InputError if the origin lies inside the sphere (where D3DX takes 90 degrees), or `radius` is not
    positive; else as `directional`.
    """
    axis, colour = unit_and_colour(center, radiance, "center")
    distance = length(as_double(center, axis))
    radius = as_double(radius, axis)
    check("radius", radius, radius > 0, "must be above 0")
    check("radius", radius, radius < distance, "must be less than the distance of the center from the origin")
    return zonal_light(axis, sh.disc(torch.asin(radius / distance), order), colour)


def hemisphere(
    up: Vector, sky: Colour, ground: Colour, order: int, *, normalise: bool = False
) -> Float[Tensor, "... N 3"]:
    """Radiance that goes linearly in z from `ground` at -`up` to `sky` at +`up`; exact from order 2 on.

    A surface that faces up reads `5/6 sky + 1/6 ground`, so equal colours are `constant`. With `normalise` all
    is scaled by 6/5 (by 2 at order 1) and a sky of 1 over a black ground reads 1. That is what the comment of
    XMSHEvalHemisphereLight in DirectXMath promises; its code multiplies by 3/2 and reads 5/4.

    Raises InputError as `directional`.
    """
    check_order(order)
    axis, top = unit_and_colour(up, sky, "up")
    _, bottom = unit_and_colour(axis, ground, "up")
    top, bottom = torch.broadcast_tensors(top, bottom)
    mean, slope = (top + bottom) / 2, (top - bottom) / 2
    if normalise:
        mean, slope = (colour * (6 / 5 if order > 1 else 2.0) for colour in (mean, slope))
    none = [0.0] * order
    flat, linear = (
        torch.tensor(factors[:order], dtype=torch.float64, device=axis.device)
        for factors in ([4 * math.pi, *none], [0.0, 4 * math.pi / 3, *none])
    )
    return zonal_light(axis, flat, mean) + zonal_light(axis, linear, slope)


def constant(radiance: Colour, order: int) -> Float[Tensor, "... N 3"]:
    """The same radiance from everywhere; any surface reads `radiance`, exactly, at every order."""
    check_order(order)
    _, colour = unit_and_colour((0.0, 0.0, 1.0), radiance)
    first = band_of(colour.device, order) == 0
    return torch.where(first[:, None], math.sqrt(4 * math.pi) * colour[..., None, :], 0.0)


def _facing(bands: Float[Tensor, "*B n"]) -> Float[Tensor, "*B"]:
    """Irradiance of a surface that faces a circularly symmetric light of radiance coefficients A_l."""
    order = bands.shape[-1]
    degree = torch.arange(order, dtype=bands.dtype, device=bands.device)
    cosine = clamped_cosine(bands.device, order, bands.dtype)
    return (bands * cosine * (2 * degree + 1)).sum(-1) / (4 * math.pi)
