"""Files of format 1, in which a kind of transfer was a layer, a signal and a diffuse layer in one; they are read, never
written."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.clustered import Clustered
from torchprt.transfer.dense import Dense
from torchprt.transfer.layer import Diffuse, EyeLayer, Layer
from torchprt.transfer.layers import Exit, Factored, Incident, Visibility
from torchprt.transfer.receivers import Texels, Vertices
from torchprt.transfer.signal import Signal
from torchprt.transfer.transfer import Transfer
from torchprt.transfer.zonal import Zonal

_CLUSTERS = ("label", "weights", "mean", "basis", "offsets", "low", "step", "squared_error")
_EYE: dict[str, type[EyeLayer]] = {"glossy": Exit, "factored": Factored, "incident": Incident, "visibility": Visibility}


def from_format1(
    kind: str, tensor: Callable[[str], Tensor], entry: Callable[[str], Any], provenance: dict[str, Any]
) -> Transfer:
    """The transfer of a file of format 1. Raises InputError if its kind is unknown."""
    stored, _, name = kind.rpartition(" ")
    if kind == "zonal map":
        return _patch(tensor, entry, provenance)
    if kind in ("clustered", "zonal"):
        stored, name = kind, "diffuse"
    if stored not in ("", "clustered", "zonal") or name not in ("diffuse", *_EYE):
        raise InputError(f"transfer is of kind '{kind}', which this torchprt does not know: update torchprt")
    original = tensor("original") if stored == "clustered" else torch.zeros(0)
    receivers = Vertices(
        positions=tensor("positions"),
        normals=tensor("normals"),
        faces=tensor("faces"),
        original=original if len(original) else None,
    )
    layers: dict[str, Layer] = {}
    if name == "diffuse":
        layers["diffuse"] = Diffuse(albedo=tensor("albedo"), signal=_signal(stored, "transfer", False, tensor, entry))
    else:
        below = _diffuse_below(stored, tensor, entry)
        if below is not None:
            layers["diffuse"] = Diffuse(albedo=tensor("albedo"), signal=below)
        made = _EYE[name]
        fields = {field.name for field in dataclasses.fields(made)} - {*made.layouts, "signal", "light_order"}
        more: dict[str, Any] = {each: tensor(each) for each in made.layouts if each != "receivers"}
        more |= {each: entry(each) for each in fields}
        if made is Visibility:
            more["light_order"] = round(tensor("diffuse").shape[1] ** 0.5)
        dense = "visibility" if made is Visibility else "matrix"
        signal = _signal(stored, dense, made is not Visibility, tensor, entry)
        layers[made.kind] = made(signal=signal, receivers=tensor("glossy"), **more)
    return Transfer(receivers=receivers, layers=layers, **provenance)


def _signal(
    stored: str, dense: str, rows: bool, tensor: Callable[[str], Tensor], entry: Callable[[str], Any]
) -> Signal:
    """The signal of the layer that a file is of; `rows`: of matrices, not of vectors."""
    if stored == "clustered":
        shared = tensor("shared")
        # Vectors had no rows, visibility neither rows nor channels.
        shared = shared.unflatten(-1, (*(1,) * (4 - shared.ndim), -1)) if shared.ndim < 4 else shared
        parts = {name: tensor(name) for name in _CLUSTERS}
        return Clustered(**parts, shared=shared, method=entry("method"), compression_error=entry("compression_error"))
    if stored == "zonal":
        parts = {name: tensor(name) for name in ("axis", "coefficients", "exact")}
        if not rows:
            parts = _with_row(**parts)
        return Zonal(
            **parts, squared_error=tensor("squared_error"), smooth=entry("smooth"), fit_error=entry("fit_error")
        )
    values = tensor(dense)
    return Dense(values=values if values.ndim > 2 else values[None])


def _diffuse_below(stored: str, tensor: Callable[[str], Tensor], entry: Callable[[str], Any]) -> Signal | None:
    """The diffuse layer of a glossy kind, if there was one."""
    if stored == "zonal":
        parts = {name: tensor(f"diffuse_{name}") for name in ("axis", "coefficients", "exact")}
        count = parts["axis"].shape[-1]
        parts = _with_row(**parts) | {"squared_error": torch.zeros(count, dtype=parts["axis"].dtype)}
        return Zonal(**parts, smooth=entry("smooth"), fit_error=None) if count else None
    vectors = tensor("diffuse")
    return Dense(values=vectors) if vectors.shape[2] else None


def _with_row(axis: Tensor, coefficients: Tensor, exact: Tensor) -> dict[str, Tensor]:
    return {"axis": axis[None], "coefficients": coefficients[:, None], "exact": exact[:, None]}


def _patch(tensor: Callable[[str], Tensor], entry: Callable[[str], Any], provenance: dict[str, Any]) -> Transfer:
    parts = {name: tensor(name).flatten(-2) for name in ("axis", "coefficients", "exact")}
    rows, columns = tensor("axis").shape[2:]
    albedo = tensor("albedo")
    if albedo.ndim != 3:
        raise InputError(f"tensor 'albedo' of the transfer has shape {list(albedo.shape)}: it must be [3|1, H|1, W|1]")
    albedo = albedo.expand(-1, rows, columns).flatten(1) if albedo[0].numel() > 1 else albedo[..., 0]
    signal = Zonal(
        **_with_row(**parts),
        squared_error=tensor("squared_error").flatten(-2),
        smooth=entry("smooth"),
        fit_error=entry("fit_error"),
    )
    return Transfer(
        receivers=Texels(rows=rows, columns=columns, tiles_u=entry("tiles_u"), tiles_v=entry("tiles_v")),
        layers={"diffuse": Diffuse(albedo=albedo.mT.contiguous(), signal=signal)},
        **provenance,
    )
