"""Light that diffuses below a surface: the dipole of two sources, one inside and its image outside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt.errors import InputError


def fresnel_average(eta: float | int) -> float:
    """What a smooth surface of relative index `eta` reflects of a uniform light that arrives from outside.

    The mean over the cosine-weighted hemisphere of Fresnel's unpolarised reflectance, by quadrature to 1e-9. From
    inside it is 1 - (1 - fresnel_average) / eta^2: what enters an etendue larger by eta^2 must come out again.
    Raises InputError unless 1 <= eta <= 4.
    """
    # Written so that NaN is refused too.
    if not 1 <= eta <= 4:
        raise InputError(f"eta is {eta:g}: give the index of refraction of the body over that around it, from 1 to 4")
    nodes, weights = np.polynomial.legendre.leggauss(64)
    # In the square root of the cosine: at small eta all that is reflected is in the last degrees before the horizon.
    root = (nodes + 1) / 2
    cosine = root**2
    inside = np.sqrt(1 - (1 - cosine**2) / eta**2)
    across = (cosine - eta * inside) / (cosine + eta * inside)
    along = (eta * cosine - inside) / (eta * cosine + inside)
    return float((weights * 2 * root**3 * (across**2 + along**2)).sum() / 2)


@dataclass(frozen=True, eq=False)
class Dipole:
    """Diffuse reflectance of a half-space by distance, of C colours, float64.

    A point that is lit sends light out of the surface around it as a source at depth `real` below it and one of the
    opposite sign at height `virtual` above it do in a medium without end: both `[C]`, in the unit of length of the
    coefficients that it was made of. `decay [C]` is the effective transport coefficient of the papers, one over the
    length in which diffuse light falls to 1/e, and `albedo [C]` the share that one scattering leaves.
    Source: Jensen, Marschner, Levoy and Hanrahan 2001, section 2.1, equation 4.
    """

    real: Float64[Tensor, "C"]
    virtual: Float64[Tensor, "C"]
    decay: Float64[Tensor, "C"]
    albedo: Float64[Tensor, "C"]

    def profile(self, distance: Float[Tensor, "*batch"]) -> Float64[Tensor, "*batch C"]:
        """What leaves a unit of area at a `distance` for a unit of light that entered at a point: R_d of the paper.

        Law: over the plane it integrates to `total`."""
        return self.at_square(distance.to(torch.float64) ** 2)

    def at_square(self, square: Float[Tensor, "*batch"]) -> Float64[Tensor, "*batch C"]:
        """`profile` of the square of a distance."""
        found = torch.zeros(1, dtype=torch.float64)
        for depth in (self.real, self.virtual):
            to_source = torch.sqrt(square[..., None] + depth**2)
            fallen = torch.exp(-self.decay * to_source)
            found = found + depth * (1 + self.decay * to_source) * fallen / to_source**3
        return found * self.albedo / (4 * torch.pi)

    def within(self, distance: Float[Tensor, "*batch"]) -> Float64[Tensor, "*batch C"]:
        """What leaves the plane up to a `distance` from the point: the integral of `profile` over the disc.

        By z e^(-s d) / d, whose derivative along d is the integrand."""
        found = torch.zeros(1, dtype=torch.float64)
        for depth in (self.real, self.virtual):
            to_source = torch.sqrt(distance.to(torch.float64)[..., None] ** 2 + depth**2)
            found = found + torch.exp(-self.decay * depth) - depth / to_source * torch.exp(-self.decay * to_source)
        return found * self.albedo / 2

    @property
    def total(self) -> Float64[Tensor, "C"]:
        """The diffuse reflectance of a half-space: of the light that enters, what leaves it anywhere.

        1 without absorption. Source: Jensen and others 2001, section 2.1, below equation 4."""
        return self.albedo / 2 * (torch.exp(-self.decay * self.real) + torch.exp(-self.decay * self.virtual))


def dipole(scattering: Float64[Tensor, "C"], absorption: Float64[Tensor, "C"], eta: float) -> Dipole:
    """The dipole of a medium of reduced `scattering` and `absorption` coefficients, per unit of length, and its index.

    The mismatch at the surface is that of `fresnel_average`, where the paper has a polynomial fit to it (the two agree
    within 1e-3 of reflectance). Source: Jensen and others 2001, section 2.1.
    """
    extinction = scattering + absorption
    inside = 1 - (1 - fresnel_average(eta)) / eta**2
    real = 1 / extinction
    return Dipole(
        real,
        real * (1 + 4 / 3 * (1 + inside) / (1 - inside)),
        torch.sqrt(3 * absorption * extinction),
        scattering / extinction,
    )
