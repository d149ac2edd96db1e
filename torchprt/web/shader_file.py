"""Transfer as shaders read it: arrays in rows of four numbers, in one file with a header that says what they are."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.hemisphere import DISCARDED
from torchprt.sh.hemisphere_basis import exit_recurrence
from torchprt.shade.view_directions import local_frames
from torchprt.transfer import Clustered, Dense, Diffuse, Exit, Layer, Signal, Transfer, Zonal
from torchprt.transfer.atlas import Atlas
from torchprt.transfer.file import CONVENTIONS
from torchprt.transfer.receivers import Receivers, Vertices
from torchprt.version import VERSION

FORMAT = 1
# Exit functions that a shader holds at a time.
MOST_ROWS = 64
Arrays = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class ShaderFile:
    """`about`, the header, and `tensors`; `transfer` is what a shader reads in them."""

    about: dict[str, Any]
    tensors: Arrays
    transfer: Transfer

    @property
    def content(self) -> bytes:
        """The bytes of the file: safetensors, so that any language has a reader."""
        from safetensors.numpy import save

        return save(self.tensors, metadata={"torchprt_gpu": json.dumps(self.about, allow_nan=False)})


def shader_file(transfer: Transfer, *, exact: bool = False) -> ShaderFile:
    """`transfer` in the layouts of docs/gpu.md, numbers in float16, or all in float32 if `exact`.

    Raises InputError if a layer is neither diffuse nor exit, zonal lobes are not the one diffuse layer, exit functions
    are more than 64, or it is recorded at what shaders do not draw.
    """
    kind = torch.float32 if exact else torch.float16
    receivers, tensors = _placed(transfer.receivers, exact)
    layers: list[dict[str, Any]] = []
    read: dict[str, Layer] = {}
    for number, (name, layer) in enumerate(transfer.layers.items()):
        said, arrays, stored = _layer(layer, transfer.receivers, kind)
        if said["signal"] == Zonal.kind and (len(transfer.layers) > 1 or said["kind"] != Diffuse.kind):
            raise InputError(
                "shaders draw zonal lobes of one diffuse layer alone: export .onnx, or fit the diffuse one"
            )
        layers.append(said)
        read[name] = stored
        tensors |= {f"{number}.{key}": value for key, value in arrays.items()}
    glossy = {(each["output_order"], each["projection"]) for each in layers if each["kind"] == Exit.kind}
    if len(glossy) > 1:
        raise InputError("the exit layers of the transfer are of several orders: bake all with one --output-order")
    about = {
        "format": FORMAT,
        "torchprt": VERSION,
        "conventions": CONVENTIONS,
        "kind": transfer.kind,
        "order": transfer.order,
        "transport": transfer.transport,
        "bounces": transfer.bounces,
        **receivers,
        "layers": layers,
    }
    return ShaderFile(about, tensors, transfer.with_layers(**read))


@functools.singledispatch
def _placed(receivers: Receivers, exact: bool) -> tuple[dict[str, Any], Arrays]:
    raise InputError(
        f"shaders draw transfer at vertices and at the texels of a map, not at {receivers.kind}: export .onnx or a page"
    )


@_placed.register
def _(receivers: Vertices, exact: bool) -> tuple[dict[str, Any], Arrays]:
    if not len(receivers.faces):
        raise InputError("shaders draw faces, and this transfer was recorded at loose points: export .onnx")
    return {"receivers": "vertices", "count": receivers.count}, {}


@_placed.register
def _(receivers: Atlas, exact: bool) -> tuple[dict[str, Any], Arrays]:
    count, gutter = receivers.count, len(receivers.gutter)
    place = torch.zeros(receivers.rows * receivers.columns, dtype=torch.int64)
    place[receivers.texel.long()] = torch.arange(1, count + 1)
    place[receivers.gutter.long()] = torch.arange(count + 1, count + 1 + gutter)
    # A texture has one texel at least.
    sources, shares = torch.zeros(max(gutter, 1), 4), torch.zeros(max(gutter, 1), 4)
    sources[:gutter], shares[:gutter] = receivers.gutter_sources.float(), receivers.gutter_weights.float()
    if count >= 1 << 24:
        raise InputError(
            f"the map has {count} texels with transfer, and shaders count to {1 << 24}: bake a smaller one"
        )
    said = {"receivers": "atlas", "count": count, "rows": receivers.rows, "columns": receivers.columns}
    return said, {
        "place": place.numpy().astype("<u4"),
        "sources": _numbers(sources, torch.float32),
        "shares": _numbers(shares, torch.float32 if exact else torch.float16),
    }


def _layer(layer: Layer, receivers: Receivers, kind: torch.dtype) -> tuple[dict[str, Any], Arrays, Layer]:
    said, arrays, layer = _seen(layer, receivers)
    signal, stored, read = _stored(layer.signal, kind)
    weight = layer.weight.detach().expand(-1, 3)
    said |= {"count": layer.signal.shape[0], "channels": layer.signal.shape[1], "rows": layer.signal.shape[2]} | signal
    changes: dict[str, Any] = {"signal": read}
    if len(weight) == 1 and said["count"] != 1:
        said["uniform"] = weight[0].tolist()
    else:
        said["uniform"] = None
        arrays["weight"] = _numbers(_padded(weight), kind)
        changes[layer.weight_name] = layer.weight.to(kind).to(layer.weight.dtype)
    said["some"] = layer.receivers is not None
    if layer.receivers is not None:
        row = torch.zeros(receivers.count, dtype=torch.int64)
        row[layer.receivers.long()] = torch.arange(1, said["count"] + 1)
        arrays["rows"] = row.numpy().astype("<u4")
    return said, arrays | stored, layer.replace(**changes)


@functools.singledispatch
def _seen(layer: Layer, receivers: Receivers) -> tuple[dict[str, Any], Arrays, Layer]:
    """What the functions of the eye are, and the layer with a row for each that a shader evaluates."""
    raise InputError(
        f"shaders draw diffuse and exit layers, and this transfer has one of {layer.kind}: export .onnx or a page "
        "without --gpu, or bake it with --frame exit"
    )


@_seen.register
def _(layer: Diffuse, receivers: Receivers) -> tuple[dict[str, Any], Arrays, Layer]:
    return {"kind": "diffuse"}, {}, layer


@_seen.register
def _(layer: Exit, receivers: Receivers) -> tuple[dict[str, Any], Arrays, Layer]:
    if layer.output_order**2 > MOST_ROWS:
        raise InputError(
            f"shaders take exit functions of order 8 at most, not {layer.output_order}: bake a lower order"
        )
    index = layer.index(receivers.count)
    frames, has_frame = local_frames(receivers.normals[index], layer.tangents)
    table, sectoral = exit_recurrence(layer.output_order, layer.projection)
    said = {
        "kind": "exit",
        "output_order": layer.output_order,
        "projection": layer.projection,
        "table": table.tolist(),
        "sectoral": sectoral.tolist(),
    }
    arrays = {
        "places": _numbers(_padded(receivers.positions[index]), torch.float32),
        "frames": _numbers(_padded(frames[:, [0, 2]].flatten(0, 1)), torch.float32),
    }
    rows = layer.signal.shape[2]
    if rows != layer.output_order**2:
        # The function that "reduced" leaves out, with nothing in it.
        kept = [i for i in range(rows + 1) if i != DISCARDED]
        wide = torch.eye(rows + 1, dtype=torch.float64)[:, kept]
        layer = layer.replace(signal=layer.signal.combined(wide), projection="zero")
    if not bool(has_frame.all()):
        specular = layer.specular.expand(len(index), -1) * has_frame[:, None].to(layer.specular.dtype)
        layer = layer.replace(specular=specular)
    return said, arrays, layer


@functools.singledispatch
def _stored(signal: Signal, kind: torch.dtype) -> tuple[dict[str, Any], Arrays, Signal]:
    """What is said of a signal, its arrays, and the signal that they are; any that has no layout here as dense."""
    return _dense(signal.dense(), kind)


@_stored.register
def _dense(signal: Dense, kind: torch.dtype) -> tuple[dict[str, Any], Arrays, Signal]:
    values = signal.values.detach()
    channels = len(values)
    # Receivers, rows, channels, coefficients.
    rows = values.permute(2, 0, 1) if values.ndim == 3 else values.permute(1, 2, 0, 3).flatten(0, 1)
    count = rows.shape[-1]
    padded = torch.zeros(len(rows), channels, 4 * -(-count // 4), dtype=kind)
    padded[..., :count] = rows.to(kind)
    return {"signal": "dense"}, {"values": _numbers(padded.reshape(-1, 4), kind)}, signal.to(kind)


@_stored.register
def _(signal: Clustered, kind: torch.dtype) -> tuple[dict[str, Any], Arrays, Signal]:
    _, channels, rows, count = signal.shape
    clusters, counts, label = len(signal.mean), signal.counts, signal.label.long()
    vectors = int(counts.max()) if clusters else 0
    whole = signal.representatives(torch.float32)
    if len(signal.shared):
        whole = whole @ signal.shared.float().flatten(1)
    # Every cluster its mean and as many vectors as the one with most.
    table = torch.zeros(clusters, vectors + 1, whole.shape[1])
    table[:, 0] = whole[:clusters]
    owner = torch.arange(clusters).repeat_interleave(counts)
    table[owner, 1 + torch.arange(len(owner)) - signal.offsets.long()[owner]] = whole[clusters:]
    table = table.reshape(clusters, vectors + 1, channels, rows, count).transpose(2, 3)
    _, blended, starts = signal.blend(torch.float32)
    wide = torch.zeros(len(label), 4 * -(-vectors // 4))
    receiver = torch.arange(len(label)).repeat_interleave(counts[label])
    wide[receiver, torch.arange(len(receiver)) - starts[receiver]] = blended
    if clusters > 1 << 16:
        raise InputError(f"the transfer has {clusters} clusters, and shaders take {1 << 16}: compress it in fewer")
    arrays = {
        "label": label.numpy().astype("<u2"),
        "weights": _numbers(wide.reshape(-1, 4) if vectors else torch.zeros(1, 4), kind),
        "representatives": _numbers(table.flatten(), torch.float32),
    }
    none = signal.low[:0].float()
    read = signal.replace(weights=blended.to(kind).float(), low=none, step=none)
    return {"signal": "clustered", "clusters": clusters, "vectors": vectors}, arrays, read


@_stored.register
def _(signal: Zonal, kind: torch.dtype) -> tuple[dict[str, Any], Arrays, Signal]:
    # Four numbers of bands 0 and 1 of every channel, then of every lobe its axis and the bands of every channel.
    low = signal.exact[:, 0].permute(2, 0, 1).flatten(1)
    lobes = torch.cat([signal.axis[0].permute(2, 0, 1), signal.coefficients[:, 0].permute(3, 1, 0, 2).flatten(2)], -1)
    numbers = torch.cat([low, lobes.flatten(1)], 1).detach()
    padded = torch.zeros(len(numbers), 4 * -(-numbers.shape[1] // 4))
    padded[:, : numbers.shape[1]] = numbers
    said = {"signal": "zonal", "lobes": signal.lobes, "exact": signal.exact.shape[2] > 0}
    return said, {"lobes": _numbers(padded.reshape(-1, 4), kind)}, signal.to(kind)


def _padded(values: Float[Tensor, "G 3"]) -> Float[Tensor, "G 4"]:
    values = values.detach().float()
    return torch.cat([values, values.new_zeros(len(values), 1)], 1)


def _numbers(values: Tensor, kind: torch.dtype) -> np.ndarray:
    found: np.ndarray = values.detach().cpu().to(kind).contiguous().numpy()
    return found.astype(found.dtype.newbyteorder("<"))
