"""Integrals of a BRDF against functions of one direction, as functions of the other direction."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Literal

import torch
from jaxtyping import Float64
from torch import Tensor

from torchprt import sh
from torchprt.brdf.half import half_rule
from torchprt.brdf.models import Brdf
from torchprt.errors import InputError

Over = Literal["views", "lights"]
Functions = Callable[[Tensor], Tensor]
Family = Callable[[Tensor, int], Tensor]

TOLERANCE = 3e-5
# What edges (tables, Phong exponents below 1) may cost when refining stops.
RELAXED = 1e-3
_LEVELS = (16, 32, 64, 128, 256)
_LARGEST_TABLE = 2048
# From here on edges are taken for what stops the error from falling.
_PATIENT_LEVEL, _PATIENT_TABLE = 32, 128
# Measured with lobes about the view itself, at which the first rule is wrong by a third.
_NODES_IN_A_LOBE = 3
# Numbers held at once: 100 MB in float64.
_CHUNK = 12_000_000
# The table ends just above the horizon, where models without a limit of their own (f = 0) begin.
_LAST_ANGLE = math.pi / 2 - 1e-6


def integrals(
    brdf: Brdf, fixed: Float64[Tensor, "D 3"], family: Family, order: int, *, over: Over
) -> Float64[Tensor, "D N"]:
    """int y_i(v) f(v, s) s_z dv for `fixed` lights s (`over` "views"), or int y_i(s) f(v, s) s_z ds for fixed views.

    y_i are those of `family`, `sh.basis` or `sh.hemisphere_basis`, of `order`. Right to 3e-5 of the RMS over all fixed
    directions, 1e-3 for reflectances with edges. Isotropic models are integrated for fixed directions in the plane
    y = 0 only, over whose angle theta a cubic spline is refined; then c_lm(theta) times cos(m phi) or sin(m phi).
    Others are tabulated over azimuths too, with trigonometric interpolation between them. The tables are kept.
    Zero for fixed directions at or below the horizon.
    Raises InputError if the reflectance is too narrow for that.
    """
    brdf = brdf.plain()
    spline, azimuths = _table(brdf, family, order, over)
    parts = [fixed.new_zeros(0, order * order)]
    band = sh.bands(order)
    m = torch.arange(order * order) - band * (band + 1)
    for chunk in fixed.split(max(1, _CHUNK // (4 * azimuths * order * order))):
        across = torch.linalg.vector_norm(chunk[:, :2], dim=-1)
        theta, phi = torch.atan2(across, chunk[:, 2]), torch.atan2(chunk[:, 1], chunk[:, 0])
        held = torch.from_numpy(spline((1 - (1 - theta / _LAST_ANGLE).clamp(0, 1).sqrt()).numpy()))
        if brdf.isotropic:
            turn = phi[:, None] * m.abs()
            values = held[:, 0, band * (band + 1) + m.abs()] * torch.where(m >= 0, turn.cos(), turn.sin())
        else:
            values = _between(held, phi)
        parts.append(torch.where(chunk[:, 2:] > 0, values, 0.0))
    return torch.cat(parts)


def _between(values: Float64[Tensor, "D P N"], phi: Float64[Tensor, " D"]) -> Float64[Tensor, "D N"]:
    """Trigonometric interpolation of values at P equal steps around, P even."""
    count = values.shape[1]
    steps = phi[:, None] - torch.arange(count) * (2 * math.pi / count)
    # The sum of the waves of a unit impulse, the last with half weight.
    waves = torch.arange(1, count // 2)
    kernel = (1 + 2 * (steps[..., None] * waves).cos().sum(-1) + (steps * (count // 2)).cos()) / count
    return (kernel[:, None] @ values)[:, 0]


def integrate(
    brdf: Brdf, fixed: Float64[Tensor, "D 3"], functions: Functions, level: int, *, over: Over
) -> Float64[Tensor, "D K"]:
    """The same for any `functions`, from directions [D, Q, 3] to values [D, Q, K], with a rule of one `level`."""
    count = functions(fixed.new_tensor([[[0.0, 0.0, 1.0]]])).shape[-1]
    parts = [fixed.new_zeros(0, count)]
    with torch.no_grad():
        for chunk in fixed.split(max(1, _CHUNK // (2 * level * level * (count + 40)))):
            above = chunk[:, 2:] > 0
            held = torch.where(above, chunk, chunk.new_tensor([0.0, 0.0, 1.0]))
            # Around the normal an anisotropic lobe is the narrower the more its two widths differ.
            other, weights = half_rule(held, level if brdf.isotropic else level // 2, 2 * level)
            held = held[:, None]
            values = brdf(other, held) * held[..., 2] if over == "views" else brdf(held, other) * other[..., 2]
            # Components come first in memory: one product for each fixed direction.
            table = functions(other).permute(0, 2, 1)
            parts.append(torch.where(above, (table @ (values * weights)[..., None])[..., 0], 0.0))
    return torch.cat(parts)


def settled(
    brdf: Brdf, fixed: Float64[Tensor, "D 3"], functions: Functions, *, over: Over, tolerance: float = TOLERANCE
) -> tuple[int, Float64[Tensor, "D K"]]:
    """The first level whose integrals agree with those of twice the level to `tolerance` of their RMS, and the latter.

    Raises InputError if none does (to 1e-3 at the last).
    """
    # The rule follows lobes about the mirror direction; others must not fall between its nodes.
    usable = [level for level in _LEVELS if level * brdf.width >= (0 if brdf.about_mirror else _NODES_IN_A_LOBE)]
    if not usable:
        raise _too_narrow(brdf)
    last = integrate(brdf, fixed, functions, usable[0], over=over)
    for level in usable:
        finer = integrate(brdf, fixed, functions, 2 * level, over=over)
        change = float((finer - last).norm())
        allowed = max(tolerance, RELAXED) if level >= _PATIENT_LEVEL else tolerance
        if change <= (tolerance if brdf.about_mirror else allowed) * float(finer.norm()):
            return level, finer
        last = finer
    if change <= RELAXED * float(finer.norm()):
        return 2 * level, finer
    raise _too_narrow(brdf)


@functools.lru_cache(maxsize=64)
def _table(brdf: Brdf, family: Family, order: int, over: Over) -> tuple[Callable, int]:
    """The integrals as a cubic spline over the angle of the fixed direction, and how many azimuths it holds.

    Its values are `[azimuths, N]`, at equal steps; one azimuth, 0, if the BRDF is isotropic.
    """
    from scipy.interpolate import CubicSpline

    def functions(directions: Tensor) -> Tensor:
        return family(directions, order)

    def at(steps: Tensor, azimuths: int, offset: float = 0.0) -> Tensor:
        theta = _LAST_ANGLE * steps * (2 - steps)
        phi = (torch.arange(azimuths, dtype=torch.float64) + offset) * (2 * math.pi / azimuths)
        theta, phi = torch.meshgrid(theta, phi, indexing="ij")
        fixed = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
        return integrate(brdf, fixed.reshape(-1, 3), functions, level, over=over).reshape(len(steps), azimuths, -1)

    with torch.inference_mode(False):
        level = _settled(brdf, functions, over)
        azimuths = 1
        few = torch.linspace(0, 1, 9, dtype=torch.float64)
        if not brdf.isotropic:
            azimuths, values = 8, at(few, 8)
            while True:
                found = at(few, azimuths, 0.5)
                # Trigonometric interpolation half way between the azimuths.
                waves = torch.fft.rfft(values, dim=1)
                shift = torch.polar(
                    torch.tensor(1.0).double(), math.pi / azimuths * torch.arange(waves.shape[1]).double()
                )
                guess = torch.fft.irfft(waves * shift[:, None], n=azimuths, dim=1)
                values = torch.stack([values, found], 2).flatten(1, 2)
                if _agree(brdf, few, guess, found, TOLERANCE, azimuths > _LARGEST_TABLE // 8):
                    break
                azimuths *= 2
        steps = torch.linspace(0, 1, 17, dtype=torch.float64)
        values = at(steps, azimuths)
        while True:
            between = (steps[1:] + steps[:-1]) / 2
            found = at(between, azimuths)
            guess = torch.from_numpy(CubicSpline(steps.numpy(), values.numpy())(between.numpy()))
            steps, place = torch.cat([steps, between]).sort()
            values = torch.cat([values, found])[place]
            # With the points between, the error of a cubic spline falls to a sixteenth of what was found.
            if _agree(brdf, between, guess, found, 8 * TOLERANCE, len(steps) > _LARGEST_TABLE):
                return CubicSpline(steps.numpy(), values.numpy()), azimuths


def _settled(brdf: Brdf, functions: Functions, over: Over) -> int:
    some = sh.fibonacci(48)[0]
    return settled(brdf, some[some[:, 2] > 0], functions, over=over)[0]


def _agree(brdf: Brdf, steps: Tensor, guess: Tensor, found: Tensor, tolerance: float, last: bool) -> bool:
    """Whether a table is fine enough. Raises InputError if it is not and it is the `last` that is tried."""
    # The solid angle that each step stands for: steps crowd near the horizon.
    area = ((_LAST_ANGLE * steps * (2 - steps)).sin() * (1 - steps)).sqrt()[:, None, None]
    error, size = float((area * (guess - found)).norm()), float((area * found).norm())
    if last and error > RELAXED * size:
        raise _too_narrow(brdf)
    patient = not brdf.about_mirror and len(steps) >= _PATIENT_TABLE
    return last or error <= (max(tolerance, RELAXED) if patient else tolerance) * size


def _too_narrow(brdf: Brdf) -> InputError:
    return InputError(
        f"the reflectance '{brdf.spec}' is too narrow or too rough to be integrated: make it smoother or rougher"
    )
