"""From transfer to zonal transfer."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, overload

import torch
from torch import Tensor

from torchprt.compression.lobes import Lobes, fit_lobes
from torchprt.compression.smooth_lobes import SMOOTHNESS
from torchprt.errors import InputError
from torchprt.progress import Report
from torchprt.transfer import DiffuseTransfer, FactoredTransfer, Transfer, ZonalFactoredTransfer, ZonalTransfer


@overload
def fit(transfer: DiffuseTransfer, **options: Any) -> ZonalTransfer: ...
@overload
def fit(transfer: FactoredTransfer, **options: Any) -> ZonalFactoredTransfer: ...
@overload
def fit(transfer: Transfer, **options: Any) -> ZonalTransfer | ZonalFactoredTransfer: ...
def fit(
    transfer: Transfer,
    *,
    lobes: int = 4,
    smooth: bool = False,
    restarts: int = 0,
    seed: int = 0,
    smoothness: float = SMOOTHNESS,
    report: Report | None = None,
) -> ZonalTransfer | ZonalFactoredTransfer:
    """The vectors of diffuse, or the rows and the diffuse layer of factored transfer, as zonal lobes, by `fit_lobes`.

    Channels share the axes. Rows are fitted one by one over all receivers. What the fit costs is in the result:
    `squared_error` of every receiver and `fit_error`, relative RMS (of the rows, if there are any).

    Raises InputError as `fit_lobes`, if the transfer has no receivers, or for a kind whose rows do not turn with the
    surface.
    Source: Sloan, Luna and Snyder 2005, sections 3.2 and 4.1.
    """
    options: dict[str, Any] = {"smooth": smooth, "restarts": restarts, "seed": seed, "smoothness": smoothness}
    options["report"] = report
    if isinstance(transfer, DiffuseTransfer):
        if transfer.vertices == 0:
            raise InputError("transfer has no receivers: there is nothing to fit")
        made = _lobes(transfer.transfer, lobes, transfer.faces, options)
        fields = _fields(transfer, ("transfer",))
        return ZonalTransfer(
            **fields,
            axis=made.axis,
            coefficients=made.coefficients,
            exact=made.exact,
            squared_error=made.error.float(),
            smooth=smooth,
            fit_error=_relative(made.error, transfer.transfer),
        )
    if isinstance(transfer, FactoredTransfer):
        return _factored(transfer, lobes, options)
    raise InputError(
        f"transfer is {transfer.kind}: fit lobes to diffuse transfer, or to glossy transfer that was baked with factors"
    )


def _factored(transfer: FactoredTransfer, lobes: int, options: dict[str, Any]) -> ZonalFactoredTransfer:
    if len(transfer.glossy) == 0:
        raise InputError("transfer has no glossy receivers: there is nothing to fit")
    rows = transfer.matrix.shape[2]
    between = _between(transfer.faces, transfer.glossy, transfer.vertices)
    made = [_lobes(transfer.matrix[:, :, i].mT, lobes, between, options) for i in range(rows)]
    diffuse = _lobes(transfer.diffuse, lobes, transfer.faces, options)
    error = torch.stack([one.error for one in made]).sum(0)
    return ZonalFactoredTransfer(
        **_fields(transfer, ("matrix", "diffuse")),
        diffuse=transfer.diffuse[:, :, :0],
        axis=torch.stack([one.axis for one in made]),
        coefficients=torch.stack([one.coefficients for one in made], 1),
        exact=torch.stack([one.exact for one in made], 1),
        diffuse_axis=diffuse.axis,
        diffuse_coefficients=diffuse.coefficients,
        diffuse_exact=diffuse.exact,
        squared_error=error.float(),
        smooth=options["smooth"],
        fit_error=_relative(error, transfer.matrix),
    )


def _lobes(
    vectors: Tensor,
    lobes: int,
    faces: Tensor,
    options: dict[str, Any],
) -> Lobes:
    """Lobes of transfer `vectors [C, N, V]`, in float32 if they are stored in half precision."""
    wide = vectors if vectors.dtype == torch.float64 else vectors.float()
    if wide.shape[2] == 0:
        # A layer that is not there has no neighbours either.
        options, faces = options | {"smooth": False}, faces[:0]
    return fit_lobes(wide.permute(2, 0, 1), lobes, faces=faces, **options)


def _between(faces: Tensor, receivers: Tensor, vertices: int) -> Tensor:
    """The faces whose corners are all among the `receivers`, as numbers of those."""
    number = torch.full((vertices,), -1, device=faces.device)
    number[receivers.long()] = torch.arange(len(receivers), device=faces.device)
    corners = number[faces.long()]
    return corners[(corners >= 0).all(1)]


def _relative(error: Tensor, vectors: Tensor) -> float:
    power = float(torch.linalg.vector_norm(vectors, dtype=torch.float64))
    return math.sqrt(float(error.sum())) / power if power > 0 else 0.0


def _fields(transfer: Any, without: tuple[str, ...]) -> dict[str, Any]:
    return {f.name: getattr(transfer, f.name) for f in dataclasses.fields(transfer) if f.name not in without}
