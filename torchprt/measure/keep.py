"""What was measured, kept by what it is of: never the same measurement twice, in whatever sweep."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from torch import Tensor

from torchprt.checkpoint import fingerprint
from torchprt.errors import InputError
from torchprt.files import make_folder, write
from torchprt.scene import Scene
from torchprt.transfer import Transfer, load, save
from torchprt.transport import hemisphere
from torchprt.version import VERSION

# Of the records; a change of what is measured is another.
_FORMAT = 1


class Kept:
    """Records and transfers in a folder, each under a key that says all it depends on (`key_of`).

    Whatever is written is whole or not there, so that a sweep may be stopped at any time; all may use one folder.
    """

    def __init__(self, folder: str | os.PathLike[str]):
        self.folder = Path(folder)

    def record(self, key: str) -> dict[str, Any] | None:
        """What was measured, None if it was not. Raises InputError, naming the file, if that is damaged."""
        path = self._path(key, ".json")
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as fault:
            raise InputError(f"{path} cannot be read: remove it, and it is measured again") from fault
        if not isinstance(found, dict):
            raise InputError(f"{path} is no record of a measurement: remove it, and it is measured again")
        return found

    def keep(self, key: str, record: dict[str, Any]) -> dict[str, Any]:
        """Writes a record and gives it back. Raises InputError if it cannot be written."""
        path = self._path(key, ".json")
        make_folder(path.parent)
        write(path, json.dumps(record).encode())
        return record

    def has_transfer(self, key: str) -> bool:
        return self._path(key, ".safetensors").is_file()

    def transfer(self, key: str) -> Transfer:
        """Raises InputError if it is not there or damaged."""
        return load(self._path(key, ".safetensors"))

    def keep_transfer(self, key: str, transfer: Transfer) -> None:
        """Raises InputError if it cannot be written."""
        path = self._path(key, ".safetensors")
        make_folder(path.parent)
        save(transfer, path)

    def partial(self, key: str) -> Path:
        """A folder for what is not done yet."""
        make_folder(self.folder)
        return self.folder / f"{key}.partial"

    def done(self, key: str) -> None:
        """Removes what `partial` held."""
        shutil.rmtree(self.folder / f"{key}.partial", ignore_errors=True)

    @property
    def bytes(self) -> int:
        """Of all files in the folder."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())

    def _path(self, key: str, suffix: str) -> Path:
        return self.folder / key[:2] / f"{key}{suffix}"


def default_folder() -> Path:
    """`torchprt/tradeoff` in XDG_CACHE_HOME, or in `~/.cache`."""
    named = os.environ.get("XDG_CACHE_HOME")
    return (Path(named) if named else Path.home() / ".cache") / "torchprt" / "tradeoff"


def key_of(what: str, tensors: Iterable[Tensor] = (), **parameters: Any) -> str:
    """The key of a measurement: a digest of what it is, all it depends on, and the version of torchprt."""
    return fingerprint(tensors, {"what": what, "format": _FORMAT, "version": VERSION, **parameters})[:40]


def key_of_scene(scene: Scene) -> str:
    """Geometry, albedo and gloss; not the names of objects."""
    geometry = scene.geometry()
    fields = [getattr(geometry, field.name) for field in dataclasses.fields(geometry)]
    tensors = [value for value in fields if isinstance(value, Tensor)]
    # The values of a gloss, not its text: tables have none of their own.
    probes = hemisphere(64)
    tensors += [brdf(probes[:, None], probes) for brdf in geometry.gloss]
    return key_of("scene", tensors, roles=list(geometry.roles))


def key_of_transfer(transfer: Transfer) -> str:
    """Receivers and layers, whatever the file is called."""
    parts = {f"receivers.{name}": value for name, value in transfer.receivers.tensors().items()}
    about: dict[str, Any] = {"receivers": transfer.receivers.kind}
    for name, layer in transfer.layers.items():
        parts |= {f"{name}.{part}": value for part, value in layer.tensors().items()}
        parts |= {f"{name}.signal.{part}": value for part, value in layer.signal.tensors().items()}
        about[name] = [layer.kind, layer.signal.kind, repr(layer.metadata()), repr(layer.signal.metadata())]
    return key_of("transfer", parts.values(), names=list(parts), about=about)
