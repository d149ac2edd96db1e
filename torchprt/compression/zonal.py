"""From dense signals to signals in zonal lobes."""

from __future__ import annotations

import math
from typing import Any

import torch
from jaxtyping import Int
from torch import Tensor

from torchprt.compression.lobes import Lobes, fit_lobes
from torchprt.compression.smooth_lobes import SMOOTHNESS
from torchprt.compression.transfer import faces_between
from torchprt.errors import InputError
from torchprt.progress import Parts, Report
from torchprt.transfer import Dense, Transfer, Zonal


def fit(
    transfer: Transfer,
    *,
    lobes: int = 4,
    smooth: bool = False,
    restarts: int = 0,
    seed: int = 0,
    smoothness: float = SMOOTHNESS,
    report: Report | None = None,
) -> Transfer:
    """Every layer in zonal lobes, by `fit_lobes`: the vectors of diffuse, the rows of all other layers.

    Channels share the axes. Rows are fitted one by one over all receivers: few rows cost little, as those of factored
    transfer, and the 25 of exit matrices cost 25 times a diffuse layer, in time and in bytes. What a fit costs is in
    its signal: `squared_error` of every receiver and `fit_error`, relative RMS.

    Raises InputError as `fit_lobes`, if the transfer has no receivers, is compressed already, holds visibility, or is
    of a volume.
    Source: Sloan, Luna and Snyder 2005, sections 3.2 and 4.1.
    """
    options: dict[str, Any] = {"smooth": smooth, "restarts": restarts, "seed": seed, "smoothness": smoothness}
    options["report"] = report
    if not transfer.receivers.on_surface:
        raise InputError(
            "lobes are for transfer that turns with a surface, and a volume has no surface: compress it in clusters"
        )
    fitted = {}
    for name, layer in transfer.layers.items():
        signal = layer.signal
        if not layer.meets_light:
            raise InputError(
                f"{layer.kind} has no lobes: it is held in functions of the hemisphere of each receiver, which turn "
                "with its frame, and not in those of the sphere of light, as lobes are: bake with factors instead"
            )
        if signal.approximates:
            raise InputError(f"transfer of kind '{transfer.kind}' is compressed already: fit lobes to what was baked")
        if signal.shape[0] == 0:
            raise InputError("transfer has no receivers: there is nothing to fit")
        fitted[name] = layer.replace(signal=_zonal(signal.dense(), lobes, faces_between(transfer, layer), options))
    return transfer.with_layers(**fitted)


def _zonal(dense: Dense, lobes: int, faces: Int[Tensor, "F 3"], options: dict[str, Any]) -> Zonal:
    values = dense.values
    rows = [values] if values.ndim == 3 else [row.mT for row in values.unbind(2)]
    told = None if options["report"] is None else Parts(options["report"], len(rows))
    made = [_lobes(row, lobes, faces, options | {"report": told}) for row in rows]
    error = torch.stack([one.error for one in made]).sum(0)
    power = float(torch.linalg.vector_norm(values, dtype=torch.float64))
    return Zonal(
        axis=torch.stack([one.axis for one in made]),
        coefficients=torch.stack([one.coefficients for one in made], 1),
        exact=torch.stack([one.exact for one in made], 1),
        squared_error=error.float(),
        smooth=options["smooth"],
        fit_error=math.sqrt(float(error.sum())) / power if power > 0 else 0.0,
    )


def _lobes(vectors: Tensor, lobes: int, faces: Tensor, options: dict[str, Any]) -> Lobes:
    """Lobes of transfer `vectors [C, N, G]`."""
    return fit_lobes(vectors.permute(2, 0, 1), lobes, faces=faces, **options)
