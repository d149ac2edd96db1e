"""What keeps a checkpoint from being used for other work than it is of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable

import torch
from torch import Tensor


class CheckpointWarning(UserWarning):
    """A checkpoint of other work was found and is not used."""


def fingerprint(tensors: Iterable[Tensor], parameters: dict[str, object]) -> str:
    """A digest of all that decides the result of a work."""
    digest = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode())
    for tensor in tensors:
        digest.update(f"{tuple(tensor.shape)} {tensor.dtype}".encode())
        digest.update(tensor.detach().cpu().contiguous().view(torch.uint8).numpy().data)
    return digest.hexdigest()
