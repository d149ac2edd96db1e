"""One file format for every transfer: safetensors with string metadata that says what stands where."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.suffixes import check_readable, refuse_other
from torchprt.transfer.d3dx import SUFFIXES, load_d3dx
from torchprt.transfer.format1 import from_format1
from torchprt.transfer.layer import Layer
from torchprt.transfer.layout import Part
from torchprt.transfer.mapped import MappedFile
from torchprt.transfer.receivers import Receivers
from torchprt.transfer.signal import Signal
from torchprt.transfer.transfer import SELDOM, Transfer
from torchprt.transfer.written import Entry, write_pieces

FORMAT = 2
# Bytes of a file from which on it is mapped: fewer are copied in no time, and are safe from whoever writes into it.
_MAPPED = 1 << 26
CONVENTIONS = (
    "real orthonormal spherical harmonics with the Condon-Shortley sign, index l(l+1)+m; world frame, y up; "
    "directions point away from the surface; transfer carries 1/pi, albedo of the receiver is separate"
)
_PROVENANCE = [field.name for field in dataclasses.fields(Transfer) if field.name not in ("receivers", "layers")]


def save(transfer: Transfer, path: str | os.PathLike[str], *, dtype: torch.dtype | None = None) -> None:
    """Writes a transfer to `path` (`.safetensors`); a reader never sees half of it.

    The file holds the tensors of the receivers by name, those of a layer as `layer.name`, those of its signal as
    `layer.signal.name`; the metadata are the format version, conventions, provenance, and as JSON what the receivers,
    the layers and their signals are, and which tensors they have. `dtype`: that signals are stored as, as
    `Transfer.to(dtype)` would have them. A piece is written at a time, so that tensors may be maps of files that are
    larger than memory.
    Raises InputError if a value is NaN or infinite, or `path` cannot be written or has another suffix.
    """
    path = Path(path)
    if path.suffix.lower() != ".safetensors":
        raise InputError(f"{path} must end in .safetensors")
    transfer.check()
    layers = []
    entries = {name: Entry(value, value.dtype) for name, value in transfer.receivers.tensors().items()}
    for name, layer in transfer.layers.items():
        signal = layer.signal
        entries |= {f"{name}.{each}": Entry(value, value.dtype) for each, value in layer.tensors().items()}
        entries |= {
            f"{name}.signal.{each}": Entry(value, dtype if dtype and each in signal.stored else value.dtype)
            for each, value in signal.tensors().items()
        }
        layers.append({"name": name, **_said(layer), "signal": _said(signal)})
    metadata = {"kind": transfer.kind, "format": str(FORMAT), "conventions": CONVENTIONS}
    metadata |= {"receivers": json.dumps(_said(transfer.receivers)), "layers": json.dumps(layers)}
    metadata |= {name: json.dumps(value) for name, value in transfer.provenance.items()}
    with atomic(path) as temporary, temporary.open("wb") as file:
        write_pieces(file, entries, metadata)


def load(path: str | os.PathLike[str], *, mapped: bool | None = None, numbers: bool = True) -> Transfer:
    """Reads a transfer that `save` wrote, of this format or an older one; the tensors are on the CPU.

    Tensors of a file of 64 MiB or more are maps of it, those of a smaller one copies, unless `mapped` says otherwise.
    A map is read from disk where it is used, so that the file may be larger than memory; what is written into it stays
    in this process. Replacing the file, as `save` does, is no harm: the map is of the former one (Windows refuses it).
    Writing into the file in its place, as `cp` does, changes the map, and cutting it short ends the process when what
    is gone is read: where that may happen, or on a network disk that may go away, read it with `mapped=False`.

    Values are checked as they are read once, some at a time. Without `numbers` dense signals are not looked at.
    A `.prt` or `.pca` that D3DX saved is read as `load_d3dx` does without a mesh.
    Raises InputError, naming the file and the fault, if it is missing, truncated or foreign, of a newer format, holds a
    kind of layer or signal that is unknown, lacks a tensor or metadata, or a tensor has the wrong shape, dtype or a
    value that is not finite.
    """
    path = check_readable(path, "give a file that `torchprt bake` wrote")
    if path.suffix.lower() in SUFFIXES:
        return load_d3dx(path)
    refuse_other(path, "a transfer")
    try:
        file = MappedFile(path)
        stays = path.stat().st_size >= _MAPPED if mapped is None else mapped
    except OSError as fault:
        if fault.errno == errno.ENOMEM:
            raise InputError(f"{path} does not fit into the memory of this process ({fault.strerror})") from fault
        raise _not_whole(path, fault) from fault
    except SafetensorError as fault:
        raise _not_whole(path, fault) from fault

    def tensor(name: str) -> Tensor:
        if name not in file.names:
            raise InputError(f"{path} lacks the tensor '{name}': it is damaged, bake it again")
        value = file.tensor(name)
        return value if stays else value.clone()

    return _read(path, file.metadata, tensor, numbers)


def _not_whole(path: Path, fault: Exception) -> InputError:
    return InputError(f"{path} is not a whole safetensors file ({fault}): bake it again")


def _read(path: Path, metadata: dict[str, str], tensor: Callable[[str], Tensor], numbers: bool) -> Transfer:
    if "kind" not in metadata or "format" not in metadata:
        raise InputError(f"{path} is not a transfer of torchprt: give a file that `torchprt bake` wrote")
    if metadata["format"] not in map(str, range(1, FORMAT + 1)):
        found = metadata["format"]
        raise InputError(f"{path} has format {found}, newer than the {FORMAT} of this torchprt: update torchprt")

    def entry(name: str) -> Any:
        try:
            return json.loads(metadata[name])
        except (KeyError, json.JSONDecodeError) as fault:
            raise InputError(f"{path} lacks the metadata '{name}': it is damaged, bake it again") from fault

    try:
        provenance = {name: entry(name) for name in _PROVENANCE if name in metadata or name not in SELDOM}
        if metadata["format"] == "1":
            transfer = from_format1(metadata["kind"], tensor, entry, provenance)
        else:
            receivers = _part(Receivers.family, "receivers", entry("receivers"), tensor, "")
            layers: dict[str, Layer] = {}
            for said in entry("layers"):
                name = said.pop("name")
                if name in layers:
                    raise InputError(f"two layers are called '{name}': it is damaged, bake it again")
                signal = _part(Signal.family, "signal", said.pop("signal"), tensor, f"{name}.signal.")
                layers[name] = _part(Layer.family, "layer", said, tensor, f"{name}.", signal=signal)
            transfer = Transfer(receivers=receivers, layers=layers, **provenance)
        transfer.check(numbers=numbers)
    except InputError as fault:
        text = str(fault)
        raise InputError(text if text.startswith(str(path)) else f"{path}: {text}") from fault
    except (KeyError, TypeError, AttributeError) as fault:
        raise InputError(f"{path} has damaged metadata ({fault}): bake it again") from fault
    except (IndexError, ValueError, RuntimeError) as fault:
        # Of so few dimensions that it cannot be brought into the layouts of today.
        raise InputError(f"{path} has a tensor of a shape that its kind has not: bake it again") from fault
    return transfer


def _said(part: Part) -> dict[str, Any]:
    return {"kind": part.kind, "tensors": list(part.tensors()), **part.metadata()}


def _part(
    family: dict[str, type[Any]], what: str, said: dict[str, Any], read: Callable[[str], Tensor], of: str, **parts: Part
) -> Any:
    """A part of a transfer from what the metadata say of it, and from its tensors, whose names start with `of`."""
    kind = said.pop("kind")
    if kind not in family:
        raise InputError(f"{what} of kind '{kind}' is unknown to this torchprt: update torchprt")
    return family[kind](**{name: read(of + name) for name in said.pop("tensors")}, **said, **parts)
