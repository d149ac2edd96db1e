"""A safetensors file, a piece at a time: tensors need not be in memory, nor lie in the order of the file."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import BinaryIO

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.pieces import pieces

NAMES = {
    torch.float64: "F64",
    torch.float32: "F32",
    torch.float16: "F16",
    torch.bfloat16: "BF16",
    torch.int64: "I64",
    torch.int32: "I32",
    torch.int16: "I16",
    torch.int8: "I8",
    torch.uint8: "U8",
    torch.bool: "BOOL",
}


@dataclass(frozen=True)
class Entry:
    """A tensor of a file, and the `dtype` that it is stored as."""

    value: Tensor
    dtype: torch.dtype

    @property
    def bytes(self) -> int:
        return self.value.numel() * self.dtype.itemsize


def write_pieces(file: BinaryIO, entries: Mapping[str, Entry], metadata: Mapping[str, str]) -> None:
    """Writes tensors by name and `metadata` from the beginning of an empty `file`.

    No more of a tensor than a piece is copied at a time. The same tensors and metadata are the same bytes. The writer
    of the library has all tensors as bytes in memory. Raises InputError if values are too large for the dtype.
    Source: the format of safetensors, https://github.com/huggingface/safetensors (a length, a header in JSON, tensors
    by row with the widest types first).
    """
    names = sorted(entries, key=lambda name: (-entries[name].dtype.itemsize, name))
    header: dict[str, object] = {"__metadata__": dict(metadata)}
    places, end = {}, 0
    for name in names:
        entry = entries[name]
        places[name], end = end, end + entry.bytes
        header[name] = {
            "dtype": NAMES[entry.dtype],
            "shape": list(entry.value.shape),
            "data_offsets": [places[name], end],
        }
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    file.write(len(text).to_bytes(8, "little") + text)
    for name in names:
        _write(file, 8 + len(text) + places[name], entries[name], name)


def _write(file: BinaryIO, start: int, entry: Entry, name: str) -> None:
    """One tensor, whose first byte stands at `start`."""
    value = entry.value.detach()
    value = value[None] if value.ndim == 0 else value
    size, steps = entry.dtype.itemsize, [math.prod(value.shape[axis + 1 :]) for axis in range(value.ndim)]
    for place in pieces(value):
        found = value[place]
        part = torch.empty(found.shape, dtype=entry.dtype).copy_(found)
        if entry.dtype != value.dtype and part.is_floating_point() and not bool(part.isfinite().all()):
            narrow = str(entry.dtype).removeprefix("torch.")
            raise InputError(f"tensor '{name}' of the transfer holds values too large for {narrow}: store float32")
        # All axes behind `axis` are whole, so that what stands along it is one run of the file.
        axis = value.ndim - 1
        while axis and part.shape[axis] == value.shape[axis]:
            axis -= 1
        runs = part.view(-1).view(torch.uint8).view(-1, size * math.prod(part.shape[axis:])).numpy()
        before = itertools.product(*(range(each.start, each.stop) for each in place[:axis]))
        for run, index in zip(runs, before, strict=True):
            first = place[axis].start * steps[axis] + sum(i * step for i, step in zip(index, steps, strict=False))
            file.seek(start + size * first)
            file.write(memoryview(run))
