"""One file format for every kind of transfer: safetensors with string metadata."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.transfer.kinds import KINDS, Transfer
from torchprt.transfer.layout import tensors

FORMAT = 1
# The kind of `ZonalMap`, which no shader takes as it is.
MAP = "zonal map"
CONVENTIONS = (
    "real orthonormal spherical harmonics with the Condon-Shortley sign, index l(l+1)+m; world frame, y up; "
    "directions point away from the surface; transfer carries 1/pi, albedo of the receiver is separate"
)


def save(transfer: Transfer, path: str | os.PathLike[str]) -> None:
    """Writes a transfer to `path` (`.safetensors`); a reader never sees half of it.

    The file holds the tensors by name and string metadata: kind, format version, conventions and provenance.
    Raises InputError if a value is NaN or infinite, or `path` cannot be written or has another suffix.
    """
    save_kind(transfer, path)


def save_kind(transfer: Any, path: str | os.PathLike[str]) -> None:
    """`save` of anything that has a kind, layouts and a check."""
    path = Path(path)
    if path.suffix.lower() != ".safetensors":
        raise InputError(f"{path} must end in .safetensors")
    transfer.check()
    metadata = {"kind": transfer.kind, "format": str(FORMAT), "conventions": CONVENTIONS}
    for field in dataclasses.fields(transfer):
        if field.name not in transfer.layouts:
            metadata[field.name] = json.dumps(getattr(transfer, field.name))
    contents = {name: value.detach().cpu().contiguous() for name, value in tensors(transfer).items()}
    with atomic(path) as temporary:
        save_file(contents, temporary, metadata=metadata)


def load(path: str | os.PathLike[str]) -> Transfer:
    """Reads a transfer that `save` wrote; the tensors are on the CPU.

    Raises InputError, naming the file and the fault, if it is missing, truncated or foreign, of an unknown kind or a
    newer format, lacks a tensor or metadata, or a tensor has the wrong shape, dtype or a value that is not finite.
    """
    return load_kind(path, KINDS)


def load_kind(path: str | os.PathLike[str], kinds: Mapping[str, type]) -> Any:
    """`load` of one of `kinds`."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist: give a file that `torchprt bake` wrote")
    try:
        with safe_open(path, framework="pt") as file:
            metadata = file.metadata() or {}
            kind = _kind(path, metadata, kinds)
            found = set(file.keys())
            missing = sorted(set(kind.layouts) - found)
            if missing:
                raise InputError(f"{path} lacks the tensor '{missing[0]}': it is damaged, bake it again")
            values: dict[str, Any] = {name: file.get_tensor(name) for name in kind.layouts}
    except (SafetensorError, OSError) as fault:
        raise InputError(f"{path} is not a whole safetensors file ({fault}): bake it again") from fault
    for field in dataclasses.fields(kind):
        if field.name not in kind.layouts:
            values[field.name] = _entry(path, metadata, field.name)
    try:
        transfer = kind(**values)
        transfer.check()
    except InputError as fault:
        raise InputError(f"{path}: {fault}") from fault
    return transfer


def _kind(path: Path, metadata: dict[str, str], kinds: Mapping[str, type]) -> Any:
    if "kind" not in metadata or "format" not in metadata:
        raise InputError(f"{path} is a safetensors file but not a transfer: give a file that `torchprt bake` wrote")
    if not metadata["format"].isdigit() or int(metadata["format"]) > FORMAT:
        raise InputError(
            f"{path} has format {metadata['format']}, newer than the {FORMAT} that this torchprt reads: update torchprt"
        )
    if metadata["kind"] == MAP and MAP not in kinds:
        raise InputError(f"{path} holds a map of a patch, not transfer of receivers: read it with load_map")
    if metadata["kind"] in KINDS and metadata["kind"] not in kinds:
        raise InputError(f"{path} holds transfer of receivers, not a map of a patch: read it with load")
    if metadata["kind"] not in kinds:
        raise InputError(
            f"{path} holds transfer of kind '{metadata['kind']}', which this torchprt does not know: update torchprt"
        )
    return kinds[metadata["kind"]]


def _entry(path: Path, metadata: dict[str, str], name: str) -> Any:
    try:
        return json.loads(metadata[name])
    except (KeyError, json.JSONDecodeError) as fault:
        raise InputError(f"{path} lacks the metadata '{name}': it is damaged, bake it again") from fault
