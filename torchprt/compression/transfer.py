"""From transfer to clustered transfer and back."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal

import torch
from torch import Tensor

from torchprt.compression.coherence import make_coherent
from torchprt.compression.cpca import ClusteredPca, pack
from torchprt.compression.quantise import QuantisedPca, quantise
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.shared_axes import shared_axes
from torchprt.errors import InputError
from torchprt.transfer import (
    BakedTransfer,
    ClusteredFactoredTransfer,
    ClusteredGlossyTransfer,
    ClusteredIncidentTransfer,
    ClusteredTransfer,
    ClusteredVisibilityTransfer,
    CompressedTransfer,
    DiffuseTransfer,
    FactoredTransfer,
    GlossyTransfer,
    IncidentTransfer,
    Transfer,
    VisibilityTransfer,
)
from torchprt.transfer.kinds import DIFFUSE

Method = Literal["iterative", "adaptive", "static", "pca", "vq"]

# What a kind becomes, the tensor that is compressed, and which of its dimensions the receivers are.
_FORMS: dict[type[BakedTransfer], tuple[type[CompressedTransfer], str, int]] = {
    DiffuseTransfer: (ClusteredTransfer, "transfer", 2),
    GlossyTransfer: (ClusteredGlossyTransfer, "matrix", 1),
    FactoredTransfer: (ClusteredFactoredTransfer, "matrix", 1),
    IncidentTransfer: (ClusteredIncidentTransfer, "matrix", 1),
    VisibilityTransfer: (ClusteredVisibilityTransfer, "visibility", 1),
}
_CHUNK = 1 << 14


def encode(
    transfer: BakedTransfer,
    clusters: int,
    components: int,
    *,
    method: Method,
    bits: int,
    shared: int,
    coherence: float,
    iterations: int,
    seed: int,
    importance: Tensor | None,
    passes: Passes,
) -> CompressedTransfer:
    """Clustered transfer of exactly these sizes; see `compress`."""
    signal = signal_of(transfer)
    axes = None
    data = signal
    if shared:
        axes, data = shared_axes(signal, shared, importance)
        # Plain distances in these axes are those of the importance.
        importance = None
    passes = passes.named(f"{clusters}-{components}-{shared}")
    packed = pack(data, clusters, components, method, iterations, seed, importance, passes)
    if coherence > 0:
        packed = make_coherent(data, packed, receiver_faces(transfer), budget=coherence, importance=importance)
    stored = packed if bits == 32 else quantise(data, packed, bits=bits, importance=importance)
    form, name, receivers = _FORMS[type(transfer)]
    tensor = getattr(transfer, name)
    shape = [size for axis, size in enumerate(tensor.shape) if axis != receivers]
    tensors = _tensors(stored, clusters)
    rows = signal.new_zeros(0, signal.shape[1]) if axes is None else axes
    tensors["shared"] = rows.unflatten(1, shape).to(tensors["mean"].dtype).contiguous()
    fields: dict[str, Any] = {
        field.name: getattr(transfer, field.name) for field in dataclasses.fields(transfer) if field.name != name
    }
    made = form(**fields, **tensors, squared_error=signal.new_zeros(len(signal)), method=method)
    # Of what is stored, not as the importance weighs it nor in fewer axes.
    squared = squared_error(signal, made)
    power = float(torch.linalg.vector_norm(signal, dtype=torch.float64))
    relative = math.sqrt(float(squared.sum())) / power if power > 0 else 0.0
    return dataclasses.replace(made, squared_error=squared.float(), compression_error=relative)


def decompress(transfer: CompressedTransfer) -> BakedTransfer:
    """The transfer that clustered transfer stands for, in float32 (float64 if its representatives are)."""
    form = next(kind for kind, (packed, _, _) in _FORMS.items() if packed is type(transfer))
    _, name, receivers = _FORMS[form]
    fields = {f.name: getattr(transfer, f.name) for f in dataclasses.fields(form) if f.name != name}
    signal = reconstruct(transfer).unflatten(1, transfer.shared.shape[1:])
    return form(**fields, **{name: signal.movedim(0, receivers).contiguous()})


def reconstruct(transfer: CompressedTransfer) -> Tensor:
    """`[V, S]`: the signal of every receiver, in bounded temporary memory."""
    dtype = torch.promote_types(transfer.mean.dtype, torch.float32)
    rows, weights, starts = transfer.blend(dtype)
    mean, basis, shared = (part.to(dtype) for part in (transfer.mean, transfer.basis, transfer.shared.flatten(1)))
    label = transfer.label.long()
    result = mean.new_empty(len(label), shared.shape[1])
    bounds = torch.cat([starts, starts.new_tensor([len(rows)])])
    for first in range(0, len(label), _CHUNK):
        last = min(first + _CHUNK, len(label))
        part = slice(int(bounds[first]), int(bounds[last]))
        some = mean[label[first:last]]
        if part.stop > part.start:
            some = some + torch.nn.functional.embedding_bag(
                rows[part], basis, starts[first:last] - part.start, mode="sum", per_sample_weights=weights[part]
            )
        result[first:last] = some @ shared if len(shared) else some
    return result


def squared_error(signal: Tensor, transfer: CompressedTransfer) -> Tensor:
    """Squared error of every receiver, `[V]` float64, of what is stored."""
    return torch.cat([
        (one.double() - other.double()).square().sum(1)
        for one, other in zip(signal.split(_CHUNK), reconstruct(transfer).split(_CHUNK), strict=True)
    ])  # fmt: skip


def check_kind(transfer: Transfer) -> BakedTransfer:
    """`transfer`, if it can be compressed; InputError if it is of another kind or has no receivers."""
    for kind, (_, name, receivers) in _FORMS.items():
        if isinstance(transfer, kind):
            if getattr(transfer, name).shape[receivers] == 0:
                raise InputError("the transfer has no receivers: there is nothing to compress")
            return transfer
    raise InputError(f"transfer of kind '{transfer.kind}' has no compressed form: compress what was baked")


def other_bytes(transfer: BakedTransfer) -> int:
    """Bytes of what compression leaves as it is: the diffuse layer, tables."""
    tensor = stored_signal(transfer)
    return transfer.bytes - tensor.numel() * tensor.element_size()


def stored_signal(transfer: BakedTransfer) -> Tensor:
    """What is compressed, as it is stored."""
    tensor: Tensor = getattr(transfer, _FORMS[type(transfer)][1])
    return tensor


def signal_of(transfer: BakedTransfer) -> Tensor:
    """`[V, S]`, one row a receiver, float32 at least."""
    _, name, receivers = _FORMS[type(transfer)]
    tensor = getattr(transfer, name).detach()
    return tensor.to(torch.promote_types(tensor.dtype, torch.float32)).movedim(receivers, 0).flatten(1)


def receiver_faces(transfer: Transfer) -> Tensor:
    """Triangles between receivers of the signal, `[F, 3]`: of glossy transfer, those whose corners all are glossy."""
    faces = transfer.faces.long()
    if isinstance(transfer, DIFFUSE):
        return faces
    place = torch.full((transfer.vertices,), -1, device=faces.device)
    place[transfer.glossy.long()] = torch.arange(len(transfer.glossy), device=faces.device)
    corners = place[faces]
    return corners[(corners >= 0).all(1)]


def _tensors(stored: ClusteredPca | QuantisedPca, clusters: int) -> dict[str, Any]:
    counts = stored.offsets.diff()
    padded = stored.weights if isinstance(stored, ClusteredPca) else stored.code
    real = torch.arange(padded.shape[1], device=padded.device) < counts[stored.label, None]
    ranges = isinstance(stored, QuantisedPca) and stored.code.dtype == torch.uint8
    none = stored.mean.new_zeros(0, dtype=torch.float32)
    return {
        "label": stored.label.to(_label_dtype(clusters)),
        "weights": padded[real],
        "mean": stored.mean,
        "basis": stored.basis,
        "offsets": stored.offsets.to(torch.int32),
        "low": stored.low if isinstance(stored, QuantisedPca) and ranges else none,
        "step": stored.step if isinstance(stored, QuantisedPca) and ranges else none,
    }


def _label_dtype(clusters: int) -> torch.dtype:
    return torch.uint8 if clusters <= 1 << 8 else torch.int16 if clusters <= 1 << 15 else torch.int32
