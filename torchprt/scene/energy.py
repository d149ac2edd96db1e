"""Whether a surface gives back more light than it gets."""

import warnings
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor

from torchprt.brdf import Brdf, check_energy, directional_albedo
from torchprt.errors import InputError

TOLERANCE = 1e-3
"""Directional albedos are known to 1e-4 of themselves; above this a sum is more than 1."""

ROUNDING = 1e-6
"""Albedos are float32: .8 (1 + .25) must not count as more than 1."""


class EnergyWarning(UserWarning):
    """A surface that reflects more light than arrives toward some directions, though not on the whole."""


class Reflected(NamedTuple):
    """How much of a uniform light a BRDF reflects."""

    mean: float
    """Over all views, weighted by the cosine: the share of the energy."""
    peak: float
    """Toward the view that gets most."""


def check_balance(
    albedo: Float32[Tensor, "rows C"],
    specular: Float32[Tensor, "rows2 C2"],
    gloss: Brdf | None,
    translucency: float,
    name: str,
) -> None:
    """Raises InputError if a surface creates energy, warns (`EnergyWarning`) if it does toward some directions only.

    Of a uniform light it reflects albedo (1 + translucency) + specular A(v) toward v, A the directional albedo of its
    gloss. `name` begins the sentence.
    """
    body = albedo * (1 + translucency)
    if float(body.max()) > 1 + ROUNDING:
        raise InputError(
            f"{name} of {float(albedo.max()):g} with translucency {translucency:g} gives back {float(body.max()):.4g} "
            "times the light that arrives: lower the albedo or the translucency"
        )
    if gloss is None or (len(albedo) > 1 and len(specular) > 1 and len(albedo) != len(specular)):
        return  # Rows that do not fit each other do not both fit the mesh, which is what gets refused.
    share = reflected(gloss)
    if float((body + specular * share.mean).max()) > 1 + TOLERANCE:
        raise InputError(
            f"{name} up to {float(albedo.max()):g} under gloss {gloss.spec}, which reflects {share.mean:.3g} of the "
            f"light, with specular up to {float(specular.max()):g}, gives back "
            f"{float((body + specular * share.mean).max()):.4g} times the light that arrives: lower albedo or specular"
        )
    most = float((body + specular * share.peak).max())
    if most > 1 + TOLERANCE:
        warnings.warn(
            f"{name} up to {float(albedo.max()):g} under gloss {gloss.spec} is up to {most:.3g} times as bright as a "
            "uniform light around it, seen from some directions; on the whole it reflects less than arrives",
            EnergyWarning,
            stacklevel=4,
        )


def reflected(gloss: Brdf) -> Reflected:
    """How much of a uniform light `gloss` reflects. Raises InputError if it is more than arrives (`check_energy`)."""
    try:
        return _remembered(gloss)
    except TypeError:  # Tables have no hash.
        return _reflected(gloss)


def _reflected(gloss: Brdf) -> Reflected:
    check_energy(gloss)
    # The cosine-weighted mean over views is the plain mean over z^2: Gauss-Legendre in z^2, even steps of azimuth.
    nodes, weights = (torch.from_numpy(each) / 2 for each in np.polynomial.legendre.leggauss(12))
    nodes = nodes + 0.5
    turns = 1 if gloss.isotropic else 8
    azimuth = 2 * torch.pi * (torch.arange(turns, dtype=torch.float64) + 0.5) / turns
    z = nodes.sqrt()[:, None].expand(-1, turns)
    across = (1 - nodes).sqrt()[:, None]
    views = torch.stack([across * azimuth.cos(), across * azimuth.sin(), z], -1)
    albedo = directional_albedo(gloss, views)
    return Reflected(float((albedo.mean(dim=1) * weights).sum()), float(albedo.max()))


_remembered = lru_cache(maxsize=64)(_reflected)
