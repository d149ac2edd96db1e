"""Exit radiance from transferred incident radiance: the reflectance is chosen at run time."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, overload

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import Brdf, exit_chain
from torchprt.errors import InputError
from torchprt.sh import Projection, bands, basis, exit_functions, phong
from torchprt.shade.glossy import MatrixShader
from torchprt.shade.view import with_normals
from torchprt.transfer import ClusteredGlossyTransfer, ClusteredIncidentTransfer, GlossyTransfer, IncidentTransfer

_EXPONENT = 40.0
_CHUNK = 4096


class IncidentShader(MatrixShader):
    """Exit radiance of `IncidentTransfer` with a Phong lobe, or with any BRDF.

    - `exponent` k, a number or a tensor of one or G, 40 if neither is given: exit radiance is
      `sum_i A_l(k) y_i(r) (M l)_i`, r the mirror image of the view about the normal. That is incident radiance blurred
      by the lobe (k + 1) / 2 pi max(r . s, 0)^k, whose integral over the sphere is 1. There is no cosine beside it, so
      it stands for the BRDF that has the lobe divided by s_z, and under a constant light a surface is as bright as the
      light except where the lobe dips below the horizon. It can be changed or learned; zero or more.
    - `brdf`: `brdf.exit_chain` is applied instead, with `output_order` (of the transfer if omitted) and `projection`:
      the same as the `GlossyTransfer` of `with_material`, which spares the product at run time.

    Both err by what the transferred incident radiance lacks above its order. Made by `torchprt.shader(transfer)`;
    `learn` may name "matrix", "specular", "albedo", "diffuse", and "exponent".
    Raises InputError if both are given or the exponent is negative, not finite or of another shape.
    Source: Sloan, Kautz and Snyder 2002, section 4.2, equations 6 and 9; Sloan, Hall, Hart and Snyder 2003, section 3.
    """

    exponent: Tensor
    chain: Tensor
    band: Tensor

    def __init__(
        self,
        transfer: IncidentTransfer,
        exponent: float | int | Tensor | None = None,
        *,
        brdf: Brdf | None = None,
        output_order: int | None = None,
        projection: Projection = "optimal",
        dtype: torch.dtype | None = None,
        learn: Iterable[str] = (),
    ):
        lobe = self.lobe(transfer, exponent, brdf)
        tensors = {"matrix": with_normals(transfer, transfer.matrix)}
        super().__init__(transfer, dtype, learn, tensors if lobe is None else {**tensors, "exponent": lobe})
        self.reflect(transfer, brdf, output_order, projection)

    @staticmethod
    def lobe(
        transfer: IncidentTransfer | ClusteredIncidentTransfer,
        exponent: float | int | Tensor | None,
        brdf: Brdf | None,
    ) -> Tensor | None:
        """The exponent that is meant, None if it is a BRDF; InputError as the class."""
        if brdf is not None:
            if exponent is not None:
                raise InputError("exponent and brdf are both given: give one, exponent (of a Phong lobe) or brdf")
            return None
        device = transfer.positions.device
        value = torch.as_tensor(_EXPONENT if exponent is None else exponent, dtype=torch.float64, device=device)
        if value.shape not in ((), (1,), (len(transfer.glossy),)):
            raise InputError(
                f"exponent has shape {list(value.shape)}: give one, or one for each of the "
                f"{len(transfer.glossy)} glossy receivers"
            )
        if not bool((value.isfinite() & (value >= 0)).all()):
            raise InputError("exponent must be finite and zero or more")
        return value

    def reflect(
        self,
        transfer: IncidentTransfer | ClusteredIncidentTransfer,
        brdf: Brdf | None,
        output_order: int | None = None,
        projection: Projection = "optimal",
    ) -> None:
        """The constants of the lobe or of `brdf`."""
        self.incident_order = transfer.output_order
        self.output_order = output_order or transfer.output_order
        self.projection = projection
        device = self.specular.device
        if brdf is None:
            self.register_buffer("band", bands(self.incident_order).to(device), persistent=False)
        else:
            chain = exit_chain(brdf, self.output_order, self.incident_order, projection)
            self.register_buffer("chain", chain.to(device, self.specular.dtype))

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """What the SH coefficients of transferred incident radiance are weighted with, for these views."""
        if hasattr(self, "chain"):
            return exit_functions(local, self.output_order, self.projection) @ self.chain
        mirrored = local * local.new_tensor([-1.0, -1.0, 1.0])
        return basis(mirrored, self.incident_order) * phong(self.exponent, self.incident_order)[..., self.band]


@overload
def with_material(
    incident: IncidentTransfer, brdf: Brdf, output_order: int | None = None, projection: Projection = "optimal"
) -> GlossyTransfer: ...
@overload
def with_material(
    incident: ClusteredIncidentTransfer, brdf: Brdf, output_order: int | None = None, projection: Projection = "optimal"
) -> ClusteredGlossyTransfer: ...
def with_material(
    incident: IncidentTransfer | ClusteredIncidentTransfer,
    brdf: Brdf,
    output_order: int | None = None,
    projection: Projection = "optimal",
) -> GlossyTransfer | ClusteredGlossyTransfer:
    """The glossy transfer of receivers that all have `brdf`: `brdf.exit_chain @ matrix`, in float64.

    `output_order`: of the exit functions, that of `incident` if omitted. Light that bounced is as the materials of
    `incident` reflected it. The result lacks what `incident` lacks above its own order, which a bake of glossy
    transfer does not; `exit_error` is therefore not stated. Of clustered transfer the representatives are multiplied,
    and `squared_error` stays that of the incident matrices.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3 and 9.
    """
    order = output_order or incident.output_order
    chain = exit_chain(brdf, order, incident.output_order, projection).to(incident.positions.device, torch.float64)
    made: dict[str, Any] = {"materials": [brdf.spec], "output_order": order, "projection": projection}
    shared = {field.name: getattr(incident, field.name) for field in dataclasses.fields(incident)}
    if isinstance(incident, ClusteredIncidentTransfer):
        shape = incident.shared.shape[1:]
        names = ("shared",) if len(incident.shared) else ("mean", "basis")
        for name in names:
            rows = getattr(incident, name)
            product = chain @ rows.reshape(-1, *shape).double()
            made[name] = product.to(rows.dtype)
        if "shared" not in made:
            made["shared"] = made["mean"][:0]
            made |= {name: made[name].flatten(1) for name in names}
        return ClusteredGlossyTransfer(**shared | made)
    matrix = incident.matrix.new_empty(*incident.matrix.shape[:2], *(len(chain), incident.matrix.shape[3]))
    for start in range(0, len(incident.glossy), _CHUNK):
        part = slice(start, start + _CHUNK)
        matrix[:, part] = (chain @ incident.matrix[:, part].double()).to(matrix.dtype)
    return GlossyTransfer(**shared | made | {"matrix": matrix})
