"""Thin membranes as single lobes about the normal: no rays, no fit, any deformation."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import membrane
from torchprt.errors import InputError
from torchprt.scene import Scene
from torchprt.transfer import Diffuse, Transfer, Zonal
from torchprt.transport.result import uniform, vertices
from torchprt.version import VERSION


def membrane_lobes(
    scene: Scene, *, order: int = 3, translucency: float | int | Float[Tensor, "V"] | None = None
) -> Transfer:
    """Unshadowed transfer of a scene, with the light that shines through its sheets, as one lobe a receiver.

    The axis is the normal, so it is exact at any order and in any pose. `translucency` of every receiver, both sides
    of a sheet (`Scene.geometry()` tells their order), or one for all; that of the materials if it is not given. It
    may vary as an image does.

    Raises InputError if `order` is below 1, or `translucency` is outside [0, 1] or has not one value a receiver.
    Source: Sloan, Luna and Snyder 2005, section 4.2, equations 22 and 23 (thin-membrane model).
    """
    geometry = scene.geometry()
    if translucency is None:
        share = geometry.translucency.double()
    else:
        share = torch.as_tensor(translucency).detach().cpu().double()
        if share.ndim and len(share) != geometry.receivers:
            raise InputError(
                f"translucency has {len(share)} values for {geometry.receivers} receivers (both sides of a sheet are "
                "receivers): give one each"
            )
        # Written so that NaN is refused too.
        if not bool(((share >= 0) & (share <= 1)).all()):
            raise InputError("translucency leaves [0, 1]: give the share of light that comes through")
        share = share.expand(geometry.receivers)
    normals = geometry.receiver_normals
    lit = normals.abs().amax(1) > 0
    # Linear in the translucency.
    closed, through = membrane(0, order), membrane(1, order) - membrane(0, order)
    coefficients = (closed[:, None] + through[:, None] * share) * lit
    axis = torch.where(lit[:, None], normals, torch.tensor([0.0, 0.0, 1.0], dtype=normals.dtype))
    signal = Zonal(
        axis=axis.mT[None, None].float(),
        coefficients=coefficients[None, None, None].float(),
        exact=torch.zeros(1, 1, 0, len(normals)),
        squared_error=torch.zeros(len(normals)),
        smooth=True,
        fit_error=0.0,
    )
    return Transfer(
        receivers=vertices(geometry),
        layers={"diffuse": Diffuse(albedo=uniform(geometry.albedo), signal=signal)},
        transport="unshadowed",
        version=VERSION,
    )
