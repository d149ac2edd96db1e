"""What is below a surface: a medium that light enters, scatters in and leaves elsewhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt.brdf import Dipole, dipole, fresnel_average
from torchprt.errors import InputError

Coefficients = float | int | Sequence[float] | Float[Tensor, "3"]
"""One number a colour, or one for all; per mm."""

WORD = "subsurface"
"""How text for a medium by its coefficients begins."""


@dataclass(frozen=True)
class Subsurface:
    """A medium: how much light it scatters and absorbs on a millimetre of its way, in red, green and blue.

    - `scattering`: the reduced scattering coefficient, sigma_s' = (1 - g) sigma_s, three numbers or one, per mm.
    - `absorption`: the absorption coefficient, sigma_a, three numbers or one, per mm.
    - `eta`: the index of refraction, from 1 to 4.

    Raises InputError if a coefficient is below 0, not a number or not finite, if both are 0 in a colour, or if eta is
    out of range. Source: Jensen, Marschner, Levoy and Hanrahan 2001.
    """

    scattering: Coefficients
    absorption: Coefficients
    eta: float | int = 1.3
    name: str = ""
    """What it is called in reports; its text if it has no name."""

    def __post_init__(self) -> None:
        for field in ("scattering", "absorption"):
            object.__setattr__(self, field, _three(getattr(self, field), field))
        fresnel_average(self.eta)
        for colour, both in zip(("red", "green", "blue"), torch.stack(self.coefficients).sum(0), strict=True):
            if both == 0:
                raise InputError(
                    f"scattering and absorption are both 0 in {colour}: light goes straight through such a medium, "
                    "which is no diffusion; give at least one of them"
                )

    @property
    def coefficients(self) -> tuple[Float64[Tensor, "3"], Float64[Tensor, "3"]]:
        """Scattering and absorption, per mm."""
        one, other = (torch.tensor(each, dtype=torch.float64) for each in (self.scattering, self.absorption))
        return one, other

    @property
    def text(self) -> str:
        """Its name, or its coefficients as `read_subsurface` takes them."""
        numbers = [*torch.cat(self.coefficients).tolist(), float(self.eta)]
        return self.name or f"{WORD}:" + ",".join(repr(each) for each in numbers)

    @property
    def dipole(self) -> Dipole:
        """How light that enters at a point leaves around it; lengths in mm."""
        return dipole(*self.coefficients, self.eta)

    @property
    def mean_free_path(self) -> Float64[Tensor, "3"]:
        """In mm: how far light goes between two events, 1 / (scattering + absorption)."""
        return self.dipole.real

    @property
    def reflectance(self) -> Float64[Tensor, "3"]:
        """Of the light that enters a half-space, what leaves it: 1 without absorption."""
        return self.dipole.total

    @property
    def entering(self) -> float:
        """Of a uniform light on the surface, what enters: Fresnel's transmittance, averaged."""
        return 1 - fresnel_average(self.eta)


def _three(values: Coefficients, name: str) -> tuple[float, float, float]:
    try:
        numbers = torch.as_tensor(values, dtype=torch.float64).reshape(-1).tolist()
    except (TypeError, ValueError, RuntimeError) as fault:
        raise InputError(f"{name} is {values!r}: give one number or three, per mm") from fault
    if len(numbers) not in (1, 3):
        raise InputError(f"{name} has {len(numbers)} numbers: give one or three (red, green, blue), per mm")
    if not all(math.isfinite(each) and each >= 0 for each in numbers):
        raise InputError(f"{name} is {', '.join(f'{each:g}' for each in numbers)}: give numbers from 0, per mm")
    return (numbers[0], numbers[0], numbers[0]) if len(numbers) == 1 else (numbers[0], numbers[1], numbers[2])


# Per mm. Source: Jensen, Marschner, Levoy and Hanrahan 2001, figure 5, measured; index 1.5 for marble, else 1.3.
_MEASURED: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], float]] = {
    "apple": ((2.29, 2.39, 1.97), (0.0030, 0.0034, 0.046), 1.3),
    "chicken1": ((0.15, 0.21, 0.38), (0.015, 0.077, 0.19), 1.3),
    "chicken2": ((0.19, 0.25, 0.32), (0.018, 0.088, 0.20), 1.3),
    "cream": ((7.38, 5.47, 3.15), (0.0002, 0.0028, 0.0163), 1.3),
    "ketchup": ((0.18, 0.07, 0.03), (0.061, 0.97, 1.45), 1.3),
    "marble": ((2.19, 2.62, 3.00), (0.0021, 0.0041, 0.0071), 1.5),
    "potato": ((0.68, 0.70, 0.55), (0.0024, 0.0090, 0.12), 1.3),
    "skimmilk": ((0.70, 1.22, 1.90), (0.0014, 0.0025, 0.0142), 1.3),
    "skin1": ((0.74, 0.88, 1.01), (0.032, 0.17, 0.48), 1.3),
    "skin2": ((1.09, 1.59, 1.79), (0.013, 0.070, 0.145), 1.3),
    "spectralon": ((11.6, 20.4, 14.9), (0.0, 0.0, 0.0), 1.3),
    "wholemilk": ((2.55, 3.21, 3.77), (0.0011, 0.0024, 0.014), 1.3),
}

MATERIALS = {name: Subsurface(*numbers, name=name) for name, numbers in _MEASURED.items()}
"""Measured media by name. Source: Jensen, Marschner, Levoy and Hanrahan 2001, figure 5."""


def read_subsurface(text: str) -> Subsurface:
    """The medium that `text` says: a name in `MATERIALS`, or "subsurface:" and three scattering coefficients, three of
    absorption, per mm, and the index: "subsurface:0.74,0.88,1.01,0.032,0.17,0.48,1.3".

    Raises InputError, naming the text, for anything else and as `Subsurface` does.
    """
    name, colon, numbers = text.strip().partition(":")
    if not colon and name in MATERIALS:
        return MATERIALS[name]
    try:
        values = [float(part) for part in numbers.split(",")] if name == WORD else []
    except ValueError:
        values = []
    if len(values) != 7:
        raise InputError(
            f"'{text}' is no medium: write one of {', '.join(MATERIALS)}, or {WORD}: and three scattering "
            f"coefficients, three of absorption, per mm, and the index, {WORD}:0.74,0.88,1.01,0.032,0.17,0.48,1.3"
        )
    try:
        return Subsurface(values[:3], values[3:6], values[6])
    except InputError as fault:
        raise InputError(f"'{text}': {fault}") from fault
