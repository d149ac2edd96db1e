"""Integrals of a BRDF against functions of one direction, as functions of the other direction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float64
from torch import Tensor

from torchprt import sh
from torchprt.brdf.half import half_rule
from torchprt.brdf.models import Brdf
from torchprt.brdf.table_integrals import cell_integrals
from torchprt.brdf.tabulated import Tabulated
from torchprt.errors import InputError
from torchprt.sh.constant import remembered

Over = Literal["views", "lights"]
Functions = Callable[[Tensor], Tensor]
Family = Callable[[Tensor, int], Tensor]

TOLERANCE = 3e-5
# What edges (in functions of the user's, in Phong exponents below 1) may cost when refining stops.
RELAXED = 1e-3
_LEVELS = (16, 32, 64, 128, 256)
_LARGEST_TABLE = 2048
# From here on edges are taken for what stops the error from falling.
_PATIENT_LEVEL, _PATIENT_TABLE, _PATIENT_AZIMUTHS = 32, 64, 32
# Measured with lobes about the view itself, at which the first rule is wrong by a third.
_NODES_IN_A_LOBE = 3
# Numbers held at once: 100 MB in float64.
_CHUNK = 12_000_000
# A model is refused if a table needs more values of it at once (half a minute); a tenth of that for a function of the
# user's, which is slower and may never settle.
_MOST = 300_000_000
# The part of the tolerance that waves left out may cost.
_NOTHING = 1e-2
# The table ends just above the horizon, where models without a limit of their own (f = 0) begin.
_LAST_ANGLE = math.pi / 2 - 1e-6


def integrals(
    brdf: Brdf, fixed: Float64[Tensor, "D 3"], family: Family, order: int, *, over: Over
) -> Float64[Tensor, "D N"]:
    """int y_i(v) f(v, s) s_z dv for `fixed` lights s (`over` "views"), or int y_i(s) f(v, s) s_z ds for fixed views.

    y_i are those of `family`, `sh.basis` or `sh.hemisphere_basis`, of `order`. Right to 3e-5 of the RMS over all fixed
    directions, 1e-3 where there are edges (see `RELAXED`); exact for tables, see `cell_integrals`.

    Turned about the normal until the fixed direction has azimuth 0, the integrals are constant in that azimuth if the
    BRDF is isotropic, else a Fourier series; the coefficients are cubic splines over the angle from the normal. Series
    and splines are refined until they settle, and kept.
    Zero for fixed directions at or below the horizon.
    Raises InputError if the reflectance is too narrow or too rough for that.
    """
    if isinstance(brdf, Tabulated):
        return cell_integrals(brdf, fixed, family, order, views=over == "views")
    table = _table(torch.device("cpu"), brdf.plain(), family, order, over)
    band = sh.bands(order)
    m = torch.arange(order * order) - band * (band + 1)
    opposite = band * (band + 1) - m
    parts = [fixed.new_zeros(0, order * order)]
    for chunk in fixed.split(max(1, _CHUNK // (4 * (table.columns + order * order)))):
        across = torch.linalg.vector_norm(chunk[:, :2], dim=-1)
        theta, phi = torch.atan2(across, chunk[:, 2]), torch.atan2(chunk[:, 1], chunk[:, 0])
        turned = table(theta, phi)
        turn = phi[:, None] * m
        values = turned * turn.cos() - turned[:, opposite] * turn.sin()
        parts.append(torch.where(chunk[:, 2:] > 0, values, 0.0))
    return torch.cat(parts)


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
            other, weights = _rule(brdf, held, level)
            values = _weighted(brdf, held[:, None], other, over) * weights
            # Components come first in memory: one product for each fixed direction.
            table = functions(other).permute(0, 2, 1)
            parts.append(torch.where(above, (table @ values[..., None])[..., 0], 0.0))
    return torch.cat(parts)


def _rule(brdf: Brdf, fixed: Tensor, level: int) -> tuple[Tensor, Tensor]:
    # Around the normal an anisotropic lobe is the narrower the more its two widths differ.
    return half_rule(fixed, level if brdf.isotropic else level // 2, 2 * level)


def _weighted(brdf: Brdf, fixed: Tensor, other: Tensor, over: Over) -> Tensor:
    """f(v, s) s_z."""
    return brdf(other, fixed) * fixed[..., 2] if over == "views" else brdf(fixed, other) * other[..., 2]


def _turned_integrals(
    brdf: Brdf,
    theta: Float64[Tensor, " D"],
    phi: Float64[Tensor, " P"],
    family: Family,
    order: int,
    level: int,
    over: Over,
) -> Float64[Tensor, "D P N"]:
    """The integrals for fixed directions at angles `theta` and azimuths `phi`, in the frame turned back by phi.

    There the nodes of the rule, and so the functions, are the same for every azimuth.
    """
    fixed = torch.stack([theta.sin(), torch.zeros_like(theta), theta.cos()], -1)
    parts = []
    nodes = 2 * level * level
    with torch.no_grad():
        for chunk in fixed.split(max(1, _CHUNK // (nodes * (order * order + 20 * len(phi))))):
            other, weights = _rule(brdf, chunk, level)
            table = family(other, order).mT * weights[:, None]
            around = [
                _weighted(brdf, _turn(chunk[:, None, None], some), _turn(other[:, None], some), over)
                for some in phi[:, None].split(max(1, _CHUNK // (20 * nodes)))
            ]
            parts.append(torch.cat(around, 1) @ table.mT)
    return torch.cat(parts)


def _turn(directions: Float64[Tensor, "*#D 3"], phi: Float64[Tensor, "*#D"]) -> Float64[Tensor, "..."]:
    """About the normal, by `phi`; they broadcast."""
    x, y, z = directions.unbind(-1)
    cosine, sine = phi.cos(), phi.sin()
    turned = torch.broadcast_tensors(cosine * x - sine * y, sine * x + cosine * y, z)
    return torch.stack(turned, -1)


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


@dataclass(frozen=True, eq=False)
class _Table:
    """The integrals in the turned frame: a spline over the angle for every wave in the azimuth that a function has.

    Waves are numbered 1, sin phi, cos phi, sin 2 phi, ...
    """

    spline: Callable
    waves: Tensor
    functions: Float64[Tensor, "C N"]

    @property
    def columns(self) -> int:
        return len(self.waves)

    def __call__(self, theta: Float64[Tensor, " D"], phi: Float64[Tensor, " D"]) -> Float64[Tensor, "D N"]:
        held = torch.from_numpy(self.spline((1 - (1 - theta / _LAST_ANGLE).clamp(0, 1).sqrt()).numpy()))
        turn = phi[:, None] * torch.arange(int(self.waves.max() + 1) // 2 + 1)
        series = torch.stack([turn.sin(), turn.cos()], -1).flatten(1)[:, 1:]
        return (held * series[:, self.waves]) @ self.functions


@remembered(64)
def _table(brdf: Brdf, family: Family, order: int, over: Over) -> _Table:

    def at(steps: Tensor, azimuths: int, offset: float = 0.0) -> Tensor:
        if len(steps) * azimuths * 2 * level * level > (_MOST if brdf.about_mirror else _MOST // 10):
            raise _too_narrow(brdf)
        phi = (torch.arange(azimuths, dtype=torch.float64) + offset) * (2 * math.pi / azimuths)
        return _turned_integrals(brdf, _LAST_ANGLE * steps * (2 - steps), phi, family, order, level, over)

    level = _settled(brdf, lambda directions: family(directions, order), over)
    azimuths = 1
    few = torch.linspace(0, 1, 9, dtype=torch.float64)
    if not brdf.isotropic:
        azimuths, values = 8, at(few, 8)
        while True:
            found = at(few, azimuths, 0.5)
            # Trigonometric interpolation half way between the azimuths.
            waves = torch.fft.rfft(values, dim=1)
            shift = torch.polar(torch.tensor(1.0).double(), math.pi / azimuths * torch.arange(waves.shape[1]).double())
            guess = torch.fft.irfft(waves * shift[:, None], n=azimuths, dim=1)
            values = torch.stack([values, found], 2).flatten(1, 2)
            if _agree(
                brdf, few, guess, found, TOLERANCE, azimuths >= _PATIENT_AZIMUTHS, azimuths > _LARGEST_TABLE // 8
            ):
                break
            azimuths *= 2
    steps = torch.linspace(0, 1, 17, dtype=torch.float64)
    values = at(steps, azimuths)
    while True:
        between = (steps[1:] + steps[:-1]) / 2
        found = at(between, azimuths)
        guess = torch.from_numpy(_spline(steps, values)(between.numpy()))
        steps, place = torch.cat([steps, between]).sort()
        values = torch.cat([values, found])[place]
        # With the points between, the error of a cubic spline falls to a sixteenth of what was found.
        if _agree(
            brdf, between, guess, found, 8 * TOLERANCE, len(between) >= _PATIENT_TABLE, len(steps) > _LARGEST_TABLE
        ):
            return _series(steps, values)


def _series(steps: Float64[Tensor, " T"], values: Float64[Tensor, "T P N"]) -> _Table:
    """A table of values at P equal steps of azimuth, without the waves that are not there."""
    count = values.shape[1]
    waves = torch.fft.rfft(values, dim=1) / count
    # The mean, and the last wave of an even count, stand once in the sum.
    twice = torch.where((2 * torch.arange(waves.shape[1])) % count == 0, 1.0, 2.0)[:, None]
    series = torch.stack([-waves.imag * twice, waves.real * twice], 2).flatten(1, 2)[:, 1:]
    power = series.square().sum(0).flatten()
    smallest = power.argsort()
    total = power[smallest].cumsum(0)
    kept = smallest[total > (_NOTHING * TOLERANCE) ** 2 * total[-1]].sort().values if total[-1] > 0 else smallest[:1]
    functions = torch.nn.functional.one_hot(kept % values.shape[2], values.shape[2]).double()
    return _Table(_spline(steps, series.flatten(1)[:, kept]), kept // values.shape[2], functions)


def _spline(steps: Tensor, values: Tensor) -> Callable:
    from scipy.interpolate import CubicSpline

    return CubicSpline(steps.numpy(), values.numpy())


def _settled(brdf: Brdf, functions: Functions, over: Over) -> int:
    some = sh.fibonacci(48)[0]
    return settled(brdf, some[some[:, 2] > 0], functions, over=over)[0]


def _agree(
    brdf: Brdf, steps: Tensor, guess: Tensor, found: Tensor, tolerance: float, patient: bool, last: bool
) -> bool:
    """Whether a table is fine enough, for edges if it is `patient`. Raises InputError if not and it is the `last`."""
    # The solid angle that each step stands for: steps crowd near the horizon.
    area = ((_LAST_ANGLE * steps * (2 - steps)).sin() * (1 - steps)).sqrt()[:, None, None]
    error, size = float((area * (guess - found)).norm()), float((area * found).norm())
    if last and error > RELAXED * size:
        raise _too_narrow(brdf)
    return last or error <= (max(tolerance, RELAXED) if patient and not brdf.about_mirror else tolerance) * size


def _too_narrow(brdf: Brdf) -> InputError:
    return InputError(
        f"the reflectance '{brdf.spec}' is too narrow or too rough to be integrated: make it smoother or rougher"
    )
