"""Exit radiance from transferred incident radiance: the reflectance is chosen at run time."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import Brdf, exit_chain
from torchprt.errors import InputError
from torchprt.sh import Projection, bands, basis, exit_functions, phong
from torchprt.shade.eye_layer import EyeLayerModule
from torchprt.shade.layer import layer_module
from torchprt.shade.signal import Making, hold
from torchprt.transfer import Exit, Incident, Layer, Transfer

_EXPONENT = 40.0


@layer_module.register(Incident)
class IncidentLayer(EyeLayerModule):
    """Exit radiance from incident radiance with a Phong lobe, or with any BRDF, which are choices of `shader`:

    - `exponent` k, a number or a tensor of one or G, 40 if neither is given: exit radiance is
      `sum_i A_l(k) y_i(r) (M l)_i`, r the mirror image of the view about the normal. That is incident radiance blurred
      by the lobe (k + 1) / 2 pi max(r . s, 0)^k, whose integral over the sphere is 1. There is no cosine beside it, so
      it stands for the BRDF that has the lobe divided by s_z, and under a constant light a surface is as bright as the
      light except where the lobe dips below the horizon. It can be changed or learned; zero or more.
    - `brdf`: `brdf.exit_chain` is applied instead, with `output_order` (of the transfer if omitted) and `projection`:
      the same as the exit matrices of `with_material`, which spares the product at run time.

    Both err by what the transferred incident radiance lacks above its order. `learn` may name "exponent", "specular"
    and what the signal has.
    Raises InputError if both are given or the exponent is negative, not finite or of another shape.
    Source: Sloan, Kautz and Snyder 2002, section 4.2, equations 6 and 9; Sloan, Hall, Hart and Snyder 2003, section 3.
    """

    learnable = ("exponent", "specular")
    choices = ("exponent", "brdf", "output_order", "projection")
    per_receiver = ("points", "frames", "exponent")
    single = (*EyeLayerModule.single, "exponent", "chain")
    exponent: Tensor
    chain: Tensor
    band: Tensor

    def __init__(self, layer: Incident, making: Making):
        super().__init__(layer, making)
        given = making.choices
        brdf: Brdf | None = given.get("brdf")
        exponent: float | int | Tensor | None = given.get("exponent")
        self.incident_order = layer.output_order
        self.output_order: int = given.get("output_order") or layer.output_order
        self.projection: Projection = given.get("projection") or "optimal"
        self.exit_order = self.output_order
        device = self.specular.device
        if brdf is None:
            lobe = torch.as_tensor(_EXPONENT if exponent is None else exponent, dtype=torch.float64, device=device)
            count = self.points.shape[1]
            if lobe.shape not in ((), (1,), (count,)):
                raise InputError(
                    f"exponent has shape {list(lobe.shape)}: give one, or one for each of the {count} glossy receivers"
                )
            if not bool((lobe.isfinite() & (lobe >= 0)).all()):
                raise InputError("exponent must be finite and zero or more")
            hold(self, "exponent", lobe, making)
            self.register_buffer("band", bands(self.incident_order).to(device), persistent=False)
            return
        if exponent is not None:
            raise InputError("exponent and brdf are both given: give one, exponent (of a Phong lobe) or brdf")
        if "exponent" in making.learn:
            raise InputError("learn names 'exponent', but brdf is given: there is no lobe to learn")
        chain = exit_chain(brdf, self.output_order, self.incident_order, self.projection)
        self.register_buffer("chain", chain.to(device, self.frames.dtype))

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """What the SH coefficients of transferred incident radiance are weighted with, for these views."""
        if hasattr(self, "chain"):
            return exit_functions(local, self.output_order, self.projection) @ self.chain
        mirrored = local * local.new_tensor([-1.0, -1.0, 1.0])
        return basis(mirrored, self.incident_order) * phong(self.exponent, self.incident_order)[..., self.band]


def with_material(
    transfer: Transfer, brdf: Brdf, output_order: int | None = None, projection: Projection = "optimal"
) -> Transfer:
    """The transfer with `brdf` on all receivers of its incident layers: `brdf.exit_chain @ matrix`, in float64.

    `output_order`: of the exit functions, that of the incident radiance if omitted. Light that bounced is as the
    materials of the layer reflected it. The result lacks what incident radiance lacks above its own order, which a bake
    of exit matrices does not; `exit_error` is therefore not stated. Of clustered matrices the representatives are
    multiplied, and `squared_error` stays that of the incident matrices.
    Raises InputError if there is no incident layer, or its signal is in zonal lobes, whose rows cannot be combined.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3 and 9.
    """
    if not any(isinstance(layer, Incident) for layer in transfer.layers.values()):
        raise InputError(f"transfer of kind '{transfer.kind}' has its reflectance baked in: no material can be chosen")
    layers: dict[str, Layer] = {}
    for name, layer in transfer.layers.items():
        if not isinstance(layer, Incident):
            layers[name] = layer
            continue
        order = output_order or layer.output_order
        chain = exit_chain(brdf, order, layer.output_order, projection).to(layer.specular.device, torch.float64)
        # A layer that is called by its kind is so still.
        layers[Exit.kind if name == Incident.kind else name] = Exit(
            signal=layer.signal.combined(chain),
            receivers=layer.receivers,
            tangents=layer.tangents,
            specular=layer.specular,
            materials=[brdf.spec],
            output_order=order,
            projection=projection,
        )
    return dataclasses.replace(transfer, layers=layers)
