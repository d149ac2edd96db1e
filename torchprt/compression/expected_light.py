"""Importance from the light that is to be expected: how much every number of a receiver matters to its radiance."""

from __future__ import annotations

import math
from typing import Literal

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError

Turned = Literal["none", "yaw", "any"]


def natural_light_importance(
    order: int, *, falloff: float | int = 2.0, channels: int = 1, rows: int = 1
) -> Float64[Tensor, "S"]:
    """`importance` for `compress` where nothing is known of the light: `(l + 1)^-falloff` in band l, of mean 1.

    The power of a coefficient in photographed environments falls about as the inverse square of the band where no lamp
    is in sight, and hardly at all under a bare sun: a falloff of 0 weighs all bands alike. S = C M N with `channels` C
    and, for exit matrices, `rows` M, which all matter alike.

    Raises InputError if order, channels or rows is below 1, or falloff is negative or not finite.
    Source: Dror, Willsky and Adelson 2004, "Statistical characterization of real-world illumination".
    """
    _check_counts(order=order, channels=channels, rows=rows)
    if not 0 <= falloff < math.inf:
        raise InputError(f"falloff is {falloff}: it must be a finite number from 0")
    power = (sh.bands(order).double() + 1) ** -falloff
    return (power / power.mean()).repeat(channels * rows)


def light_importance(
    lights: Float[Tensor, "B N 3"],
    *,
    turned: Turned = "yaw",
    channels: int = 1,
    rows: int = 1,
    floor: float | int = 0.01,
) -> Float64[Tensor, "S S"]:
    """`importance` for `compress` from a set of environments: the second moments of their coefficients.

    The squared error that it weighs is the squared error of exit radiance, the mean over the lights, each scaled to the
    same power, and over how they may be `turned`: "none" as they are, "yaw" about +y, "any" in all ways, which leaves
    the mean power of every band. The first two are for the very lights that will be used, the last for examples.
    One channel of transfer meets all three of the light; of three channels each meets its own. S = C M N with
    `channels` C and, for exit matrices, `rows` M; of the projection "optimal" those are orthonormal, so that the error
    is that of radiance over the hemisphere.

    The mean of the diagonal is 1 before `floor` is added to it: a few lights span few of the dimensions, and what never
    matters would be lost for all others. With a floor the result is positive definite.

    Raises InputError if there is no light, N is not a square number, a number is not finite, a light is zero
    everywhere, channels is neither 1 nor 3, rows is below 1, or floor is not in (0, 1].
    Source: the shading error of Sloan, Hall, Hart and Snyder 2003, section 3.1, averaged over lights.
    """
    order = _check_lights(lights, channels, rows, turned, floor)
    lights = lights.detach().double()
    # Squares of numbers of any size must neither vanish nor overflow.
    lights = lights / lights.abs().amax((1, 2), keepdim=True)
    lights = lights / torch.linalg.vector_norm(lights, dim=(1, 2), keepdim=True)
    moments = _moments(lights, order, turned)
    if channels == 1:
        moments = moments.mean(0, keepdim=True)
    moments = moments / moments.diagonal(dim1=1, dim2=2).mean()
    moments = (moments + moments.mT) / 2 + floor * torch.eye(order**2, dtype=torch.float64, device=lights.device)
    return torch.block_diag(*moments.repeat_interleave(rows, 0))


def _moments(lights: Tensor, order: int, turned: Turned) -> Tensor:
    """Second moments `[3, N, N]`."""
    if turned == "any":
        band = sh.bands(order).to(lights.device)
        power = lights.new_zeros(3, order).index_add_(1, band, lights.square().mean(0).mT) / torch.bincount(band)
        return power[:, band].diag_embed()
    if turned == "yaw":
        # Products of two coefficients are trigonometric polynomials of degree 2 (n - 1): so many turns are exact.
        degrees = 360 * torch.arange(2 * order - 1, dtype=torch.float64, device=lights.device) / (2 * order - 1)
        turns = sh.yaw_pitch_roll(torch.stack([degrees, 0 * degrees, 0 * degrees], 1))
        lights = sh.rotate(lights[:, None], turns).flatten(0, 1)
    by_channel = lights.permute(2, 1, 0)
    return by_channel @ by_channel.mT / len(lights)


def _check_lights(lights: Tensor, channels: int, rows: int, turned: str, floor: float) -> int:
    _check_counts(rows=rows)
    if channels not in (1, 3):
        raise InputError(f"channels is {channels}: transfer has 1 or 3")
    if turned not in ("none", "yaw", "any"):
        raise InputError(f"turned is '{turned}': choose one of none, yaw, any")
    if not 0 < floor <= 1:
        raise InputError(f"floor is {floor}: it must be above 0, as 0.01 for a hundredth of the mean, and at most 1")
    if len(lights) == 0:
        raise InputError("lights is empty: give at least one environment, as coefficients [B, N, 3]")
    order = sh.order_of(lights.shape[1])
    if not lights.isfinite().all():
        raise InputError("lights holds a number that is not finite: project the environments again")
    if (lights == 0).all(2).all(1).any():
        raise InputError("lights holds one that is zero everywhere: leave it out, it says nothing")
    return order


def _check_counts(**counts: int) -> None:
    for name, count in counts.items():
        if count < 1:
            raise InputError(f"{name} is {count}: it must be 1 or more")
