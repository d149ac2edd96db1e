"""From linear radiance to what a screen shows. The one place with tone maps and sRGB."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

ToneMap = Literal["neutral", "agx", "filmic", "none"]
TONES: tuple[ToneMap, ...] = get_args(ToneMap)
TONE: ToneMap = "neutral"
"""The tone map of every picture that asks for no other."""

# Of the Khronos PBR neutral tone map: the Fresnel reflection that is taken off, where highlights begin to be
# compressed, how fast they lose their colour.
F90, START, DESATURATION = 0.04, 0.8 - 0.04, 0.15

# Of AgX: linear sRGB to linear Rec. 2020 and back, the primaries drawn in and out again, the stops that are shown.
TO_REC2020 = ((0.6274, 0.3293, 0.0433), (0.0691, 0.9195, 0.0113), (0.0164, 0.0880, 0.8956))
FROM_REC2020 = ((1.6605, -0.5876, -0.0728), (-0.1246, 1.1329, -0.0083), (-0.0182, -0.1006, 1.1187))
INSET = (
    (0.856627153315983, 0.0951212405381588, 0.0482516061458583),
    (0.137318972929847, 0.761241990602591, 0.101439036467562),
    (0.11189821299995, 0.0767994186031903, 0.811302368396859),
)
OUTSET = (
    (1.1271005818144368, -0.11060664309660323, -0.016493938717834573),
    (-0.1413297634984383, 1.157823702216272, -0.016493938717834257),
    (-0.14132976349843826, -0.11060664309660294, 1.2519364065950405),
)
LEAST_STOP, MOST_STOP = -12.47393, 4.026069
SIGMOID = (15.5, -40.14, 31.96, -6.868, 0.4298, 0.1191, -0.00232)


def neutral(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S 3"]:
    """Khronos PBR neutral: linear RGB from [0, inf) to [0, 1], made so that a base colour is seen as it was chosen.

    One to one below .8 but for .04, what a dielectric surface reflects at every angle, which is taken off; above that
    the largest channel is compressed toward 1, hues stay, and highlights turn white. Negative radiance maps to 0.
    Source: Khronos Group, "PBR neutral tone mapper", specification (2024), github.com/KhronosGroup/ToneMapping.
    """
    x = torch.clamp(radiance, min=0)
    # F90 of what is above 2 F90; below that less, so that 6.25 x^2 is left, without a step.
    low = torch.clamp(x.amin(-1, keepdim=True), max=2 * F90)
    x = x - (low - low * low / (4 * F90))
    peak = x.amax(-1, keepdim=True)
    room = 1 - START
    # Below the start these are not used, and must not divide by 0.
    high = torch.clamp(peak, min=START)
    pressed = 1 - room * room / (high + room - START)
    faded = 1 - 1 / (DESATURATION * (high - pressed) + 1)
    return torch.where(peak < START, x, torch.lerp(x * (pressed / high), pressed.expand_as(x), faded))


def agx(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S 3"]:
    """AgX: linear RGB from [0, inf) to [0, 1]; 16.5 stops on a soft curve, in which bright colours go to white.

    Suns and flames keep their gradations, at the price of contrast and of saturated base colours. Negative radiance
    maps to 0, as does what is below 2^-12.5.
    Source: Sobotka, "AgX" (2022), as in Blender 4; its curve as fitted by Wrensch, "Minimal AgX
    implementation" (2023), with the matrices for Rec. 2020 of Filament and three.js.
    """
    inward, outward, back = (radiance.new_tensor(table).T for table in (_IN, OUTSET, FROM_REC2020))
    stops = torch.log2(torch.clamp(torch.clamp(radiance, min=0) @ inward, min=1e-10))
    x = torch.clamp((stops - LEAST_STOP) / (MOST_STOP - LEAST_STOP), 0, 1)
    curve = torch.zeros_like(x)
    for coefficient in SIGMOID:
        curve = curve * x + coefficient
    return torch.clamp(torch.clamp(curve @ outward, min=0) ** 2.2 @ back, 0, 1)


def filmic(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S 3"]:
    """Filmic tone curve from [0, inf) to [0, 1]: soft toe and shoulder, mid grey .18 maps near .27 before sRGB.

    Each channel by itself, so that bright colours shift. Negative radiance maps to 0.
    Source: Narkowicz 2015, a fit of the ACES reference transform.
    """
    x = torch.clamp(radiance, min=0)
    # Divided through by x^2 above 1, so that 1e30 does not overflow float32.
    small = torch.clamp(x, max=1)
    large = 1 / torch.clamp(x, min=1)
    below = small * (2.51 * small + 0.03) / (small * (2.43 * small + 0.59) + 0.14)
    above = (2.51 + 0.03 * large) / (2.43 + large * (0.59 + 0.14 * large))
    return torch.clamp(torch.where(x > 1, above, below), max=1)


def srgb(radiance: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S 3"]:
    """Linear RGB to sRGB (IEC 61966-2-1). Values outside [0, 1] are clipped to what a screen can show."""
    x = torch.clamp(radiance, 0, 1)
    # Below the knee the power is not used, and its slope must not be infinite.
    return torch.where(x > 0.0031308, 1.055 * x.clamp(min=0.0031308) ** (1 / 2.4) - 0.055, 12.92 * x)


def linear(values: Float[Tensor, "*S 3"]) -> Float[Tensor, "*S 3"]:
    """sRGB in [0, 1] to linear RGB (IEC 61966-2-1): what `srgb` undoes."""
    return torch.where(values <= 0.04045, values / 12.92, ((values.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4)


def check_tone(name: str) -> ToneMap:
    """`name` as a tone map; InputError if there is none of that name."""
    for tone in TONES:
        if name == tone:
            return tone
    raise InputError(f"tone map '{name}' is unknown: use {', '.join(TONES[:-1])} or {TONES[-1]}")


def tone_mapped(
    radiance: Float[Tensor, "*S 3"], *, exposure: float | Tensor = 0.0, tone: ToneMap = TONE
) -> Float[Tensor, "*S 3"]:
    """Linear RGB in [0, 1] that a screen is to show for linear radiance: exposure (in stops), then tone map.

    Any float dtype; what has less than 32 bits is worked out in float32. Pictures are averaged in these values.
    Raises InputError for an unknown tone map.
    """
    curve = _CURVES[check_tone(tone)]
    wide = radiance.to(torch.promote_types(radiance.dtype, torch.float32))
    stops = torch.as_tensor(exposure, dtype=wide.dtype, device=wide.device)
    return curve(wide * torch.exp2(stops)).to(radiance.dtype)


def display(
    radiance: Float[Tensor, "*S 3"], *, exposure: float | Tensor = 0.0, tone: ToneMap = TONE
) -> Float[Tensor, "*S 3"]:
    """sRGB picture values in [0, 1] from linear radiance: exposure (in stops), tone map, sRGB, in this order.

    Raises InputError for an unknown tone map.
    """
    return srgb(tone_mapped(radiance, exposure=exposure, tone=tone))


def _clip(radiance: Tensor) -> Tensor:
    return torch.clamp(radiance, 0, 1)


def _product(a: tuple[tuple[float, ...], ...], b: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    return tuple(
        tuple(sum(x * y for x, y in zip(row, column, strict=True)) for column in zip(*b, strict=True)) for row in a
    )


_IN = _product(INSET, TO_REC2020)
_CURVES: dict[ToneMap, Callable[[Tensor], Tensor]] = {"neutral": neutral, "agx": agx, "filmic": filmic, "none": _clip}
