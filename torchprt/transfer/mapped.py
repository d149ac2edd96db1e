"""A safetensors file as a map in memory: its tensors are read from disk where they are used, and never as a whole."""

from __future__ import annotations

import json
import math
import mmap
import os
import platform
import sys
from pathlib import Path

import torch
from safetensors import safe_open
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.written import NAMES

_DTYPES = {name: dtype for dtype, name in NAMES.items()}


class MappedFile:
    """The tensors and metadata of a file.

    The map is the process's own: what is written into a tensor is a copy of the page that it is in, and never in the
    file. It reserves no memory for that, so that the file may be larger than memory; the map of torch does, and cannot
    be made then. Every tensor has a storage of its own, so that what copies storages (pickle, `torch.save`) copies no
    other tensor with it. The map lives as long as any of them.

    Raises SafetensorError if it is not a whole safetensors file, OSError if it cannot be read or mapped.
    Source: the format of safetensors, https://github.com/huggingface/safetensors.
    """

    def __init__(self, path: Path):
        with safe_open(path, framework="np") as file:
            # The library checks header, shapes and lengths; its own maps are not used.
            self.metadata: dict[str, str] = file.metadata() or {}
        with path.open("rb") as file:
            self._map = _map(file.fileno())
        length = int.from_bytes(self._map[:8], "little")
        self._entries = json.loads(self._map[8 : 8 + length])
        self._entries.pop("__metadata__", None)
        self._start = 8 + length
        self.names = frozenset(self._entries)

    def tensor(self, name: str) -> Tensor:
        """A view of the map, contiguous; a copy if a foreign writer did not align it."""
        entry = self._entries[name]
        if entry["dtype"] not in _DTYPES:
            raise InputError(f"tensor '{name}' of the transfer is {entry['dtype']}: bake it again")
        dtype, shape = _DTYPES[entry["dtype"]], entry["shape"]
        start, count = self._start + entry["data_offsets"][0], math.prod(shape)
        if not count:
            return torch.empty(shape, dtype=dtype)
        if start % dtype.itemsize:
            some = torch.frombuffer(self._map, dtype=torch.uint8, count=count * dtype.itemsize, offset=start)
            return some.clone().view(dtype).view(shape)
        return torch.frombuffer(self._map, dtype=dtype, count=count, offset=start).view(shape)


def _map(file: int) -> mmap.mmap:
    """All of a file, to be read and, without changing it, written."""
    if os.name == "nt":
        return mmap.mmap(file, 0, access=mmap.ACCESS_COPY)
    flags = mmap.MAP_PRIVATE | _no_reserve()
    return mmap.mmap(file, 0, flags=flags, prot=mmap.PROT_READ | mmap.PROT_WRITE)


def _no_reserve() -> int:
    """The flag with which the system promises no memory for pages that are written to; 0 where it is not known."""
    # Python does not name it in all versions.
    common = sys.platform == "linux" and platform.machine() in ("x86_64", "aarch64")
    return int(getattr(mmap, "MAP_NORESERVE", 0x4000 if common else 0))
