"""From a dense signal to a clustered one, and back; the layers of transfer that take them."""

from __future__ import annotations

import math
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.compression.coherence import make_coherent
from torchprt.compression.cpca import pack
from torchprt.compression.quantise import quantise
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.shared_axes import shared_axes
from torchprt.errors import InputError
from torchprt.transfer import Clustered, Dense, Layer, Transfer

Method = Literal["iterative", "adaptive", "static", "pca", "vq"]

_CHUNK = 1 << 14


def encode(
    dense: Dense,
    faces: Int[Tensor, "F 3"],
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
) -> Clustered:
    """The clustered signal of exactly these sizes, `faces` being triangles between its receivers; see `compress`."""
    signal = numbers_of(dense)
    axes = None
    data = signal
    if shared:
        axes, data = shared_axes(signal, shared, importance)
        # Plain distances in these axes are those of the importance.
        importance = None
    passes = passes.named(f"{clusters}-{components}-{shared}")
    packed = pack(data, clusters, components, method, iterations, seed, importance, passes)
    if coherence > 0:
        packed = make_coherent(data, packed, faces, budget=coherence, importance=importance)
    stored = packed if bits == 32 else quantise(data, packed, bits=bits, importance=importance)
    tensors: dict[str, Any] = stored.tensors()
    rows = signal.new_zeros(0, signal.shape[1]) if axes is None else axes
    tensors["shared"] = rows.unflatten(1, dense.shape[1:]).to(tensors["mean"].dtype).contiguous()
    made = Clustered(**tensors, squared_error=signal.new_zeros(len(signal)), method=method)
    # Of what is stored, not as the importance weighs it nor in fewer axes.
    squared = squared_error(signal, made)
    power = float(torch.linalg.vector_norm(signal, dtype=torch.float64))
    relative = math.sqrt(float(squared.sum())) / power if power > 0 else 0.0
    return made.replace(squared_error=squared.float(), compression_error=relative)


def decompress(transfer: Transfer) -> Transfer:
    """The transfer that compressed transfer stands for, every signal dense, in float32 (float64 if it is stored so).

    Raises InputError for a signal that cannot be written out number by number, as zonal lobes, whose pose a shader
    knows: `shader(transfer).fix_pose()`.
    """
    compressed = {name: layer for name, layer in transfer.layers.items() if layer.signal.approximates}
    changed = {name: layer.replace(signal=layer.signal.dense()) for name, layer in compressed.items()}
    return transfer.with_layers(**changed)


def squared_error(signal: Float[Tensor, "G S"], stored: Clustered) -> Float[Tensor, "G"]:
    """Squared error of every receiver, float64, of what is stored."""
    return torch.cat([
        (one.double() - other.double()).square().sum(1)
        for one, other in zip(signal.split(_CHUNK), stored.numbers().split(_CHUNK), strict=True)
    ])  # fmt: skip


def layer_to_compress(transfer: Transfer, name: str | None) -> tuple[str, Layer, Dense]:
    """The layer that is meant, by default the last, and its signal. InputError if there is none, or it cannot be."""
    if name is not None and name not in transfer.layers:
        raise InputError(f"layer is '{name}': the transfer has {', '.join(transfer.layers)}")
    name = list(transfer.layers)[-1] if name is None else name
    layer = transfer.layers[name]
    if layer.signal.approximates:
        raise InputError(
            f"transfer of kind '{transfer.kind}' is compressed already, by what {layer.signal.kind} signals lose: "
            "compress what was baked"
        )
    if layer.signal.shape[0] == 0:
        raise InputError("the transfer has no receivers: there is nothing to compress")
    return name, layer, layer.signal if isinstance(layer.signal, Dense) else layer.signal.dense()


def numbers_of(dense: Dense) -> Float[Tensor, "G S"]:
    """One row a receiver, S = C M N, float32 at least."""
    values = dense.dense().values.detach()
    return values.movedim(2 if values.ndim == 3 else 1, 0).flatten(1)


def faces_between(transfer: Transfer, layer: Layer) -> Int[Tensor, "F 3"]:
    """Triangles whose corners all are receivers of a layer, as numbers of those."""
    faces = transfer.faces.long()
    if layer.receivers is None:
        return faces
    index = layer.index(transfer.vertices)
    place = torch.full((transfer.vertices,), -1, device=faces.device)
    place[index] = torch.arange(len(index), device=faces.device)
    corners = place[faces]
    return corners[(corners >= 0).all(1)]
