"""From transfer to clustered transfer and back."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal, overload

import torch
from torch import Tensor

from torchprt.compress.cpca import ClusteredPca, clustered_pca
from torchprt.errors import InputError
from torchprt.transfer import ClusteredGlossyTransfer, ClusteredTransfer, DiffuseTransfer, GlossyTransfer, Transfer

Method = Literal["iterative", "adaptive", "static", "pca", "vq"]


@overload
def compress(transfer: DiffuseTransfer, **options: Any) -> ClusteredTransfer: ...
@overload
def compress(transfer: GlossyTransfer, **options: Any) -> ClusteredGlossyTransfer: ...
@overload
def compress(transfer: Transfer, **options: Any) -> ClusteredTransfer | ClusteredGlossyTransfer: ...
def compress(
    transfer: Transfer,
    *,
    clusters: int = 256,
    components: int = 8,
    method: Method = "iterative",
    iterations: int = 1,
    seed: int = 0,
    importance: Tensor | None = None,
) -> ClusteredTransfer | ClusteredGlossyTransfer:
    """Clustered PCA of the vectors of diffuse, or the exit matrices of glossy transfer, by `clustered_pca`.

    A receiver keeps a label and `components` weights; `clusters` times one more representatives are shared. The diffuse
    layer of glossy transfer stays as it is. `importance` is over the numbers of one receiver, `C N` or `C M N`. What it
    cost is in the result: `squared_error` of every receiver and `compression_error`, relative RMS.

    Raises InputError as `clustered_pca`, if the transfer has no receivers, or for a kind that has no compressed form.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3.3 and 4.
    """
    signal = _signal(transfer)
    packed = clustered_pca(
        signal,
        clusters,
        components,
        method=method,
        iterations=iterations,
        seed=seed,
        importance=importance,
    )
    shape = _shape(transfer)
    # Of what is stored, not as the importance weighs it.
    squared = packed.error if importance is None else (signal - packed.reconstruct()).double().square().sum(1)
    power = float(torch.linalg.vector_norm(signal, dtype=torch.float64))
    common: dict[str, Any] = {
        "label": packed.label.to(_label_dtype(clusters)),
        "weights": packed.weights,
        "mean": packed.mean.unflatten(1, shape).contiguous(),
        "basis": packed.basis.unflatten(1, shape).contiguous(),
        "offsets": packed.offsets.to(torch.int32),
        "squared_error": squared.to(torch.float32),
        "method": method,
        "compression_error": math.sqrt(float(squared.sum())) / power if power > 0 else 0.0,
    }
    shared = {field.name: getattr(transfer, field.name) for field in dataclasses.fields(transfer)}
    if isinstance(transfer, DiffuseTransfer):
        del shared["transfer"]
        return ClusteredTransfer(**shared, **common)
    del shared["matrix"]
    return ClusteredGlossyTransfer(**shared, **common)


def decompress(transfer: ClusteredTransfer | ClusteredGlossyTransfer) -> DiffuseTransfer | GlossyTransfer:
    """The transfer that clustered transfer stands for, in the dtype of its representatives."""
    packed = ClusteredPca(
        transfer.label.long(),
        transfer.mean.flatten(1),
        transfer.basis.flatten(1),
        transfer.offsets.long(),
        transfer.weights.to(transfer.mean.dtype),
        transfer.squared_error.double(),
    )
    signal = packed.reconstruct().unflatten(1, transfer.mean.shape[1:])
    dropped = ("label", "weights", "mean", "basis", "offsets", "squared_error", "method", "compression_error")
    shared = {
        field.name: getattr(transfer, field.name) for field in dataclasses.fields(transfer) if field.name not in dropped
    }
    if isinstance(transfer, ClusteredTransfer):
        return DiffuseTransfer(**shared, transfer=signal.permute(1, 2, 0).contiguous())
    return GlossyTransfer(**shared, matrix=signal.transpose(0, 1).contiguous())


def _signal(transfer: Transfer) -> Tensor:
    """One row a receiver, float32 at least."""
    if isinstance(transfer, DiffuseTransfer):
        rows = transfer.transfer.permute(2, 0, 1)
    elif isinstance(transfer, GlossyTransfer):
        rows = transfer.matrix.transpose(0, 1)
    else:
        raise InputError(
            f"transfer of kind '{transfer.kind}' has no compressed form: compress diffuse transfer or exit matrices"
        )
    if len(rows) == 0:
        raise InputError("the transfer has no receivers: there is nothing to compress")
    return rows.detach().to(torch.promote_types(rows.dtype, torch.float32)).flatten(1)


def _shape(transfer: Transfer) -> tuple[int, ...]:
    if isinstance(transfer, DiffuseTransfer):
        return tuple(transfer.transfer.shape[:2])
    assert isinstance(transfer, GlossyTransfer)
    channels, _, rows, columns = transfer.matrix.shape
    return channels, rows, columns


def _label_dtype(clusters: int) -> torch.dtype:
    return torch.uint8 if clusters <= 1 << 8 else torch.int16 if clusters <= 1 << 15 else torch.int32
