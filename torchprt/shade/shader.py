"""Which module shades which kind of transfer."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias, overload

import torch
from torch import Tensor

from torchprt.brdf import Brdf
from torchprt.errors import InputError
from torchprt.shade.clustered import (
    ClusteredFactoredShader,
    ClusteredGlossyShader,
    ClusteredIncidentShader,
    ClusteredShader,
    ClusteredVisibilityShader,
)
from torchprt.shade.deformable import DeformableShader
from torchprt.shade.deformable_glossy import DeformableFactoredShader
from torchprt.shade.diffuse import DiffuseShader
from torchprt.shade.glossy import FactoredShader, GlossyShader
from torchprt.shade.incident import IncidentShader
from torchprt.shade.visibility import VisibilityShader
from torchprt.transfer import (
    ClusteredFactoredTransfer,
    ClusteredGlossyTransfer,
    ClusteredIncidentTransfer,
    ClusteredTransfer,
    ClusteredVisibilityTransfer,
    DiffuseTransfer,
    FactoredTransfer,
    GlossyTransfer,
    IncidentTransfer,
    Transfer,
    VisibilityTransfer,
    ZonalFactoredTransfer,
    ZonalTransfer,
)

Shader: TypeAlias = (
    DiffuseShader
    | GlossyShader
    | FactoredShader
    | IncidentShader
    | VisibilityShader
    | DeformableShader
    | DeformableFactoredShader
)

# The kinds that leave nothing to be chosen.
_SHADERS: dict[type[Transfer], Callable[..., Shader]] = {
    DiffuseTransfer: DiffuseShader,
    GlossyTransfer: GlossyShader,
    FactoredTransfer: FactoredShader,
    VisibilityTransfer: VisibilityShader,
    ClusteredTransfer: ClusteredShader,
    ClusteredGlossyTransfer: ClusteredGlossyShader,
    ClusteredFactoredTransfer: ClusteredFactoredShader,
    ClusteredVisibilityTransfer: ClusteredVisibilityShader,
    ZonalTransfer: DeformableShader,
    ZonalFactoredTransfer: DeformableFactoredShader,
}


@overload
def shader(
    transfer: DiffuseTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> DiffuseShader: ...
@overload
def shader(
    transfer: GlossyTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> GlossyShader: ...
@overload
def shader(
    transfer: FactoredTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> FactoredShader: ...
@overload
def shader(
    transfer: IncidentTransfer,
    *,
    dtype: torch.dtype | None = None,
    learn: Iterable[str] = (),
    exponent: float | int | Tensor | None = None,
    brdf: Brdf | None = None,
) -> IncidentShader: ...
@overload
def shader(
    transfer: VisibilityTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> VisibilityShader: ...
@overload
def shader(
    transfer: ClusteredIncidentTransfer,
    *,
    dtype: torch.dtype | None = None,
    learn: Iterable[str] = (),
    exponent: float | int | Tensor | None = None,
    brdf: Brdf | None = None,
) -> ClusteredIncidentShader: ...
@overload
def shader(
    transfer: ClusteredFactoredTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> ClusteredFactoredShader: ...
@overload
def shader(
    transfer: ClusteredVisibilityTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> ClusteredVisibilityShader: ...
@overload
def shader(
    transfer: ClusteredTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> ClusteredShader: ...
@overload
def shader(
    transfer: ClusteredGlossyTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> ClusteredGlossyShader: ...
@overload
def shader(
    transfer: ZonalTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> DeformableShader: ...
@overload
def shader(
    transfer: ZonalFactoredTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> DeformableFactoredShader: ...
@overload
def shader(
    transfer: Transfer,
    *,
    dtype: torch.dtype | None = None,
    learn: Iterable[str] = (),
    exponent: float | int | Tensor | None = None,
    brdf: Brdf | None = None,
) -> Shader: ...
def shader(
    transfer: Transfer,
    *,
    dtype: torch.dtype | None = None,
    learn: Iterable[str] = (),
    exponent: float | int | Tensor | None = None,
    brdf: Brdf | None = None,
) -> Shader:
    """The `nn.Module` that shades `transfer`, by its kind.

    `dtype`: of its buffers (float32, or wider if the transfer is); `learn`: names of buffers that become
    parameters, such as "albedo". For transfer of kind "incident" the reflectance: `exponent` of a Phong lobe (40 if
    neither is given) or `brdf`.
    Raises InputError for a name that cannot be learned, or a reflectance for another kind of transfer.
    """
    if isinstance(transfer, ClusteredIncidentTransfer):
        return ClusteredIncidentShader(transfer, exponent, brdf=brdf, dtype=dtype, learn=learn)
    if isinstance(transfer, IncidentTransfer):
        return IncidentShader(transfer, exponent, brdf=brdf, dtype=dtype, learn=learn)
    for name, value in (("exponent", exponent), ("brdf", brdf)):
        if value is not None:
            raise InputError(f"{name} is given, but transfer of kind '{transfer.kind}' has its reflectance baked in")
    return _SHADERS[type(transfer)](transfer, dtype=dtype, learn=learn)
