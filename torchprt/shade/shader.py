"""Which module shades which kind of transfer."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias, overload

import torch
from torch import Tensor

from torchprt.brdf import Brdf
from torchprt.errors import InputError
from torchprt.shade.clustered import ClusteredGlossyShader, ClusteredShader
from torchprt.shade.diffuse import DiffuseShader
from torchprt.shade.glossy import FactoredShader, GlossyShader
from torchprt.shade.incident import IncidentShader
from torchprt.shade.visibility import VisibilityShader
from torchprt.transfer import (
    ClusteredGlossyTransfer,
    ClusteredTransfer,
    DiffuseTransfer,
    FactoredTransfer,
    GlossyTransfer,
    IncidentTransfer,
    Transfer,
    VisibilityTransfer,
)

Shader: TypeAlias = (
    DiffuseShader | GlossyShader | FactoredShader | IncidentShader | VisibilityShader | ClusteredGlossyShader
)


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
    transfer: ClusteredTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> ClusteredShader: ...
@overload
def shader(
    transfer: ClusteredGlossyTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
) -> ClusteredGlossyShader: ...
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
    if isinstance(transfer, IncidentTransfer):
        return IncidentShader(transfer, exponent, brdf=brdf, dtype=dtype, learn=learn)
    for name, value in (("exponent", exponent), ("brdf", brdf)):
        if value is not None:
            raise InputError(f"{name} is given, but transfer of kind '{transfer.kind}' has its reflectance baked in")
    if isinstance(transfer, GlossyTransfer):
        return GlossyShader(transfer, dtype=dtype, learn=learn)
    if isinstance(transfer, FactoredTransfer):
        return FactoredShader(transfer, dtype=dtype, learn=learn)
    if isinstance(transfer, VisibilityTransfer):
        return VisibilityShader(transfer, dtype=dtype, learn=learn)
    if isinstance(transfer, ClusteredTransfer):
        return ClusteredShader(transfer, dtype=dtype, learn=learn)
    if isinstance(transfer, ClusteredGlossyTransfer):
        return ClusteredGlossyShader(transfer, dtype=dtype, learn=learn)
    return DiffuseShader(transfer, dtype=dtype, learn=learn)
