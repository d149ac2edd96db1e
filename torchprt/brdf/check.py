"""Does a reflectance give back more light than it receives, or depend on which way the light goes?"""

from __future__ import annotations

import math

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt import sh
from torchprt.brdf.integrals import integrals, settled
from torchprt.brdf.models import Brdf
from torchprt.brdf.tabulated import Tabulated
from torchprt.errors import InputError

_ACCURACY = 1e-4
# Ten times the quadrature error: models that are normalised to 1 must pass.
_ALLOWED = 1e-3


def directional_albedo(brdf: Brdf, view: Float[Tensor, "*D 3"]) -> Float64[Tensor, "*D"]:
    """int f(view, s) s_z ds: the part of the light from all around that leaves toward each unit `view`.

    By reciprocity also the part of light arriving along `view` that is reflected at all. float64, refined until it
    changes by less than 1e-4 of its RMS over the views, 1e-3 for functions of the user's with edges and Phong
    exponents below 1; exact for tables. Zero for views at or below the horizon.
    Raises InputError if directions are not of unit length or the reflectance is too narrow to be integrated.
    """
    sh.check_directions(view, "view")
    views = view.detach().reshape(-1, 3).double()
    if len(views) == 0:
        return views.new_zeros(view.shape[:-1])
    if isinstance(brdf, Tabulated):
        albedo = integrals(brdf, views, sh.basis, 1, over="lights") * math.sqrt(4 * math.pi)
        return albedo.reshape(view.shape[:-1])
    _, albedo = settled(brdf.plain(), views, lambda s: torch.ones_like(s[..., :1]), over="lights", tolerance=_ACCURACY)
    return albedo.reshape(view.shape[:-1])


def check_energy(brdf: Brdf) -> None:
    """Raises InputError if the directional albedo exceeds 1 (by more than 1e-3, ten times the quadrature error).

    Looks at 46 angles from the normal to half a degree above the horizon, for anisotropic models at 12 azimuths.
    """
    angles = torch.cat([torch.arange(0, 90, 2, dtype=torch.float64), torch.tensor([89.5], dtype=torch.float64)])
    around = torch.arange(1 if brdf.isotropic else 12, dtype=torch.float64) * 30
    theta, phi = (part.flatten() for part in torch.meshgrid(angles.deg2rad(), around.deg2rad(), indexing="ij"))
    views = torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)
    albedo = directional_albedo(brdf, views)
    worst = int(albedo.argmax())
    if not float(albedo[worst]) <= 1 + _ALLOWED:
        raise InputError(
            f"the reflectance '{brdf.spec}' gives back {float(albedo[worst]):.4g} times the light it receives at "
            f"{math.degrees(float(theta[worst])):g} degrees from the normal: scale it to at most 1"
        )


def reciprocity_error(brdf: Brdf) -> float:
    """RMS of f(v, s) - f(s, v) over 4096 pairs of directions, relative to the RMS of f; zero if f is.

    Half of the pairs are near mirror directions, where narrow lobes are.
    """
    brdf = brdf.plain()
    directions, _ = sh.fibonacci(8192)
    views = directions[directions[:, 2] > 0]
    generator = torch.Generator().manual_seed(0)
    lights = views[torch.randperm(len(views), generator=generator)]
    half = torch.randn(len(views), 3, generator=generator, dtype=torch.float64) * brdf.width
    half[:, 2] = 1
    half = torch.nn.functional.normalize(half, dim=-1)
    mirrored = 2 * (views * half).sum(-1, keepdim=True) * half - views
    lights = torch.where((torch.arange(len(views)) % 2 == 0)[:, None], lights, mirrored)
    with torch.no_grad():
        there, back = brdf(views, lights), brdf(lights, views)
    size = float(there.norm())
    return float((there - back).norm()) / size if size > 0 else float(back.norm() > 0)
