"""Daylight: the overcast sky and the clear sky with its sun."""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError
from torchprt.light.analytic import disc
from torchprt.light.arguments import Colour, Number, Vector, check, clamped_cosine, unit_and_colour, zonal_light
from torchprt.light.sun import HALF_ANGLE, srgb_of_xyz, sun_radiance
from torchprt.sh.constant import remembered

# Perez coefficients A to E of x, y and Y: slope and intercept in turbidity.
_PEREZ = (
    (
        (-0.01925, -0.25922),
        (-0.06651, 0.00081),
        (-0.00041, 0.21247),
        (-0.06409, -0.89887),
        (-0.00325, 0.04517),
    ),
    (
        (-0.01669, -0.26078),
        (-0.09495, 0.00921),
        (-0.00792, 0.21023),
        (-0.04405, -1.65369),
        (-0.01092, 0.05291),
    ),
    ((0.17872, -1.46303), (-0.35540, 0.42749), (-0.02266, 5.32505), (0.12064, -2.57705), (-0.06696, 0.37027)),
)

# Chromaticity of the zenith: rows T^2, T, 1; columns theta^3, theta^2, theta, 1.
_ZENITH_X = (
    (0.00166, -0.00375, 0.00209, 0.0),
    (-0.02903, 0.06377, -0.03202, 0.00394),
    (0.11693, -0.21196, 0.06052, 0.25886),
)
_ZENITH_Y = (
    (0.00275, -0.00610, 0.00317, 0.0),
    (-0.04214, 0.08970, -0.04153, 0.00516),
    (0.15346, -0.26756, 0.06670, 0.26688),
)

LEAST_TURBIDITY, LARGEST_TURBIDITY = 2.0, 10.0


def overcast_sky(
    zenith_radiance: Colour, up: Vector, order: int, *, ground_albedo: Colour = 0.2
) -> Float[Tensor, "... N 3"]:
    """The CIE overcast sky, `zenith_radiance * (1 + 2 cos theta) / 3`, over a diffuse ground.

    The irradiance on the ground is `7 pi / 9 * zenith_radiance`, and its radiance `ground_albedo / pi` of that.
    Closed form: a hemisphere and a clamped cosine. Directions and batches as in `directional`.

    Raises InputError as `directional`.
    Source: Moon and Spencer 1942; ISO 15469 / CIE S 011.
    """
    axis, zenith = unit_and_colour(up, zenith_radiance, "up")
    _, albedo = unit_and_colour(axis, ground_albedo, "up")
    half, cosine = _half(order, axis), clamped_cosine(axis.device, order, torch.float64)
    sky = zonal_light(axis, (half + 2 * cosine) / 3, zenith)
    return sky + zonal_light(-axis, half, 7 / 9 * albedo * zenith)


def clear_sky(
    sun_direction: Vector,
    turbidity: Number,
    order: int,
    *,
    ground_albedo: Colour = 0.2,
    sun: bool = True,
    up: Vector = (0.0, 1.0, 0.0),
) -> Float[Tensor, "... N 3"]:
    """The clear sky of Preetham, with its sun if `sun`, over a diffuse ground lit by both.

    Linear sRGB in units of 1000 cd / m^2: a sky of some 10, a sun of some 10^6. Sky: `clear_sky_radiance` by
    quadrature, within 2e-4 of its norm. Sun: a disc of .2665 degrees half angle of `sun_radiance`. Ground:
    radiance `ground_albedo / pi` times the irradiance. `turbidity` is 2 on a very clear day, 3 on a clear one, 6
    in light haze; `up` is one direction for the batch. Gradients flow to the direction of the sun, `turbidity`
    and `ground_albedo`.

    Raises InputError unless the sun stands above the horizon and 2 <= `turbidity` <= 10, where the model holds;
    else as `directional`.
    Source: Preetham, Shirley and Smits 1999, "A practical analytic model for daylight".
    """
    toward_sun, albedo = unit_and_colour(sun_direction, ground_albedo, "sun_direction")
    zenith = _one_zenith(up, toward_sun)
    nodes, weights = _upper_hemisphere(zenith, order)
    radiance = clear_sky_radiance(nodes, toward_sun, turbidity, up=zenith)
    light = (sh.basis(nodes, order).mT * weights) @ radiance
    irradiance = (weights * (nodes @ zenith)) @ radiance
    if sun:
        cosine, angle = _zenith_angle(toward_sun, zenith)
        beam = sun_radiance(angle, turbidity)
        light = light + disc(toward_sun, HALF_ANGLE, beam, order)
        # Exact for a disc wholly above the horizon.
        irradiance = irradiance + math.pi * math.sin(HALF_ANGLE) ** 2 * cosine[..., None] * beam
    return light + zonal_light(-zenith, _half(order, zenith), albedo / math.pi * irradiance)


def clear_sky_radiance(
    directions: Float[Tensor, "D 3"],
    sun_direction: Vector,
    turbidity: Number,
    *,
    up: Vector = (0.0, 1.0, 0.0),
) -> Float[Tensor, "... D 3"]:
    """Radiance of Preetham's sky (without the sun itself) in unit `directions` of the batch's suns; 0 below.

    Linear sRGB in units of 1000 cd / m^2; never out of its gamut for the turbidity allowed. Errors as `clear_sky`.
    """
    toward_sun, _ = unit_and_colour(sun_direction, 0.0, "sun_direction")
    zenith = _one_zenith(up, toward_sun)
    haze = torch.as_tensor(turbidity, dtype=toward_sun.dtype, device=toward_sun.device)
    good = (haze >= LEAST_TURBIDITY) & (haze <= LARGEST_TURBIDITY)
    check("turbidity", haze, good, f"must be from {LEAST_TURBIDITY:g} to {LARGEST_TURBIDITY:g}")
    cosine, angle = _zenith_angle(toward_sun, zenith)
    check("sun_direction", toward_sun, cosine > 0, "must point above the horizon")

    height = directions @ zenith
    # The angle between two unit vectors that loses no digits where they meet.
    apart = directions - toward_sun[..., None, :]
    along = directions + toward_sun[..., None, :]
    norm = torch.linalg.vector_norm
    gamma = 2 * torch.atan2(norm(apart, dim=-1), norm(along, dim=-1))
    coefficients = _polynomial(_PEREZ, haze)
    sky = _perez(coefficients, height.clamp(min=1e-6)[:, None], gamma[..., None])
    at_zenith = _perez(coefficients, torch.ones_like(cosine)[..., None, None], angle[..., None, None])
    x, y, luminance = ((sky / at_zenith) * _zenith_colour(angle, haze)[..., None, :]).unbind(-1)
    xyz = torch.stack([x / y, torch.ones_like(x), (1 - x - y) / y], dim=-1) * luminance[..., None]
    return torch.where(height[:, None] > 0, srgb_of_xyz(xyz), 0.0)


def _perez(coefficients: Tensor, cosine: Tensor, gamma: Tensor) -> Tensor:
    """(1 + A exp(B / cos theta)) (1 + C exp(D gamma) + E cos^2 gamma), for x, y and Y along the last axis."""
    a, b, c, d, e = coefficients[..., None, :, :].unbind(-1)
    return (1 + a * torch.exp(b / cosine)) * (1 + c * torch.exp(d * gamma) + e * gamma.cos() ** 2)


def _polynomial(table: tuple, haze: Tensor) -> Tensor:
    lines = torch.tensor(table, dtype=haze.dtype, device=haze.device)
    return lines[..., 0] * haze[..., None, None] + lines[..., 1]


def _zenith_colour(angle: Tensor, haze: Tensor) -> Float[Tensor, "*B 3"]:
    """x, y and Y of the zenith, Y in 1000 cd / m^2."""
    powers = torch.stack([angle**3, angle**2, angle, torch.ones_like(angle)], dim=-1)
    hazes = torch.stack([haze**2, haze, torch.ones_like(haze)], dim=-1)
    x, y = (
        ((powers @ torch.tensor(table, dtype=angle.dtype, device=angle.device).T) * hazes).sum(-1)
        for table in (_ZENITH_X, _ZENITH_Y)
    )
    chi = (4 / 9 - haze / 120) * (math.pi - 2 * angle)
    luminance = (4.0453 * haze - 4.9710) * chi.tan() - 0.2155 * haze + 2.4192
    return torch.stack(torch.broadcast_tensors(x, y, luminance), dim=-1)


def _one_zenith(up: Vector, like: Tensor) -> Float[Tensor, "3"]:
    zenith, _ = unit_and_colour(torch.as_tensor(up, dtype=like.dtype, device=like.device), 0.0, "up")
    if zenith.ndim != 1:
        raise InputError(f"up must be one direction for all suns, not a batch of shape {tuple(zenith.shape)}")
    return zenith.to(like)


def _zenith_angle(toward_sun: Tensor, zenith: Tensor) -> tuple[Tensor, Tensor]:
    cosine = toward_sun @ zenith
    across = toward_sun - cosine[..., None] * zenith
    return cosine, torch.atan2(torch.linalg.vector_norm(across, dim=-1), cosine)


def _half(order: int, like: Tensor) -> Float[Tensor, " n"]:
    return sh.disc(torch.tensor(math.pi / 2, dtype=torch.float64, device=like.device), order)


def _upper_hemisphere(zenith: Float[Tensor, "3"], order: int) -> tuple[Tensor, Tensor]:
    """Directions above the horizon and their weights."""
    local, weights = _about_z(zenith.device, order, zenith.dtype)
    return local @ _frame(zenith), weights


@remembered(4)
def _about_z(order: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """The same about +z: Gauss-Legendre in height, equal steps around."""
    import numpy as np

    rows = max(64, 2 * order)
    columns = 2 * rows
    points, steps = (torch.from_numpy(a).to(dtype) for a in np.polynomial.legendre.leggauss(rows))
    height = ((points + 1) / 2)[:, None]
    around = (torch.arange(columns).to(dtype) + 0.5) * (2 * math.pi / columns)
    radius = (1 - height * height).sqrt()
    local = torch.stack([radius * around.cos(), radius * around.sin(), height.expand(-1, columns)], dim=-1)
    weights = (steps / 2 * (2 * math.pi / columns))[:, None].expand(-1, columns)
    return local.reshape(-1, 3), weights.reshape(-1)


def _frame(zenith: Float[Tensor, "3"]) -> Float[Tensor, "3 3"]:
    """Rows: two directions across `zenith`, and itself."""
    least = (torch.arange(3, device=zenith.device) == zenith.detach().abs().argmin()).to(zenith)
    first = torch.linalg.cross(zenith, least)
    first = first / torch.linalg.vector_norm(first)
    return torch.stack([first, torch.linalg.cross(zenith, first), zenith])
