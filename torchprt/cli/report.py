"""What the command says: lines on standard output, complaints on standard error, what a bake holds."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.transfer import Layer, Transfer


def say(what: Any) -> None:
    print(what, flush=True)


def complain(what: Any) -> None:
    print(f"torchprt: {what}", file=sys.stderr, flush=True)


def triple(values: Tensor) -> str:
    return "({:.4g}, {:.4g}, {:.4g})".format(*values.tolist())


def describe(transfer: Transfer) -> str:
    """Kind, size and Monte Carlo error of a transfer in a line."""
    parts = [transfer.kind, transfer.transport]
    if transfer.bounces:
        parts.append(f"{transfer.bounces} {'bounce' if transfer.bounces == 1 else 'bounces'}")
    parts.append(f"order {transfer.order}")
    parts += [layer.functions for layer in transfer.layers.values() if layer.functions]
    parts += ["3 channels" if transfer.channels == 3 else "1 channel", f"{transfer.vertices} vertices"]
    counts = [layer.signal.shape[0] for layer in transfer.eye_layers.values()]
    if counts:
        parts[-1] += f" ({max(counts)} glossy)"
    largest = max(transfer.layers.values(), key=lambda layer: layer.bytes)
    parts.append(f"{transfer.bytes / 2**20:.1f} MB of {largest.signal.stored_as}")
    if transfer.error is not None and transfer.signal:
        parts.append(f"error {transfer.error / transfer.signal:.2%} (RMS, Monte Carlo estimate)")
    return ", ".join(parts)


def details(transfer: Transfer) -> list[str]:
    """Lines about where a transfer was recorded, and of each layer what it is and what it loses."""
    lines = transfer.receivers.summary()
    for name, layer in transfer.layers.items():
        told = layer.signal.summary() + layer.summary()
        drawn = _overdraw(transfer, layer)
        lines += [f"{name}: {line}" for line in told + ([drawn] if drawn else [])]
    return lines


def _overdraw(transfer: Transfer, layer: Layer) -> str:
    """How often triangles are drawn by engines that draw a cluster at a time; nothing without clusters."""
    from torchprt.compression import overdraw
    from torchprt.compression.transfer import faces_between

    label = layer.signal.tensors().get("label")
    faces = faces_between(transfer, layer)
    if label is None or not len(faces):
        return ""
    order = transfer.receivers.tensors().get("original")
    return f"overdraw {overdraw(faces, label):.3f}" + ("" if order is None else ", vertices in the order of clusters")
