"""All that a transfer holds, by name, to be compared with another."""

import torch


def contents(transfer):
    """Tensors and metadata, as `exit.signal.values` or `bounces`."""
    parts = {"": transfer.receivers}
    for name, layer in transfer.layers.items():
        parts |= {f"{name}.": layer, f"{name}.signal.": layer.signal}
    found = dict(transfer.provenance)
    for prefix, part in parts.items():
        found |= {f"{prefix}{name}": value for name, value in (part.tensors() | part.metadata()).items()}
    return found


def differing(one, other):
    """Names of what two transfers do not have alike, to the bit."""
    first, second = contents(one), contents(other)
    return {name for name in first.keys() | second.keys() if not _same(first.get(name), second.get(name))}


def _same(one, other):
    both = isinstance(one, torch.Tensor), isinstance(other, torch.Tensor)
    return torch.equal(one, other) if all(both) else not any(both) and one == other
