"""Chunks of a bake on disk: what a stopped bake keeps, and where hits wait for their bounces."""

from __future__ import annotations

import json
import os
import shutil
import warnings
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from torchprt.checkpoint import CheckpointWarning
from torchprt.errors import InputError
from torchprt.files import atomic, sentences, temporary_folder

if TYPE_CHECKING:
    from torchprt.transport.object_store import ObjectCheckpoint


def place_of(checkpoint: str | os.PathLike[str] | None) -> Path | str | None:
    """Where a checkpoint is to be: a folder of this machine, or the URL of another store."""
    if not isinstance(checkpoint, str) or "://" not in checkpoint:
        return None if checkpoint is None else Path(checkpoint)
    # Files of this machine are renamed into place, which no library of stores does.
    return Path(unquote(urlsplit(checkpoint).path)) if checkpoint.startswith("file://") else checkpoint


def kept_at(place: Path | str | None, fingerprint: str) -> Checkpoint | ObjectCheckpoint:
    """The checkpoint at a place of `place_of`."""
    if not isinstance(place, str):
        return Checkpoint(place, fingerprint)
    from torchprt.transport.object_store import ObjectCheckpoint

    return ObjectCheckpoint(place, fingerprint)


def is_there(place: Path | str) -> bool:
    """Whether a bake that stopped has left anything at a place, as far as can be told at once."""
    return isinstance(place, str) or place.exists()


def remove(place: Path | str) -> None:
    """Removes the checkpoint at a place, if there is one."""
    if not isinstance(place, str):
        shutil.rmtree(place, ignore_errors=True)
        return
    from torchprt.transport import object_store

    object_store.remove(place)


class Folder:
    """Chunks in a folder, a file each: `Results` for all who see the folder."""

    def __init__(self, folder: Path):
        self.folder = folder

    def path(self, number: int) -> Path:
        return self.folder / f"chunk-{number:07d}.safetensors"

    def save(self, number: int, tensors: dict[str, Tensor]) -> None:
        # Not durable: a chunk that a loss of power takes is traced again.
        with atomic(self.path(number), durable=False) as path:
            save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, path)

    def load(self, number: int) -> dict[str, Tensor] | None:
        """The tensors of a chunk (memory-mapped), or None if it is not there or was damaged by a crash."""
        if not self.path(number).exists():
            return None
        try:
            return load_file(self.path(number))
        except (SafetensorError, OSError):
            return None

    def read(self, number: int) -> dict[str, Tensor]:
        """The tensors of a chunk that was saved before. Raises InputError if it is not there any more."""
        contents = self.load(number)
        if contents is None:
            raise InputError(f"{self.path(number)} vanished or was damaged during the bake: run it again")
        return contents

    @property
    def fingerprint(self) -> str | None:
        """Of the bake that the chunks belong to, None if that is not said."""
        return _fingerprint_in(self.folder / "manifest.json")

    def __str__(self) -> str:
        return str(self.folder)


class Checkpoint(Folder):
    """A folder with one file a chunk and the fingerprint of the bake that they belong to.

    With `folder=None` it is a temporary one that `close` removes; otherwise it stays until `discard`. A folder left
    by a bake of another scene or with other parameters is emptied, with a CheckpointWarning.
    Raises InputError if the folder holds something else or cannot be written.
    """

    def __init__(self, folder: Path | None, fingerprint: str):
        self._temporary = temporary_folder() if folder is None else None
        super().__init__(Path(self._temporary.name) if self._temporary else Path(folder or ""))
        manifest = self.folder / "manifest.json"
        try:
            self.folder.mkdir(exist_ok=True)
            strangers = [entry for entry in self.folder.iterdir() if not self._ours(entry)]
        except OSError as fault:
            raise InputError(f"{self.folder} cannot hold the checkpoint ({fault.strerror}): name another") from fault
        if strangers:
            raise InputError(f"{self.folder} holds other files ({strangers[0].name}): name another checkpoint folder")
        if manifest.exists() and _fingerprint_in(manifest) != fingerprint:
            warnings.warn(
                f"{self.folder} is of a bake with another scene or other parameters: it is emptied, this bake starts "
                "from the beginning",
                CheckpointWarning,
                stacklevel=3,
            )
            with sentences(self.folder):
                for entry in self.folder.iterdir():
                    entry.unlink()
        if not manifest.exists():
            with atomic(manifest) as path:
                path.write_text(json.dumps({"fingerprint": fingerprint}))

    @staticmethod
    def _ours(entry: Path) -> bool:
        return entry.name.startswith((".chunk-", ".manifest.", "chunk-")) or entry.name == "manifest.json"

    def __reduce__(self) -> tuple[type[Folder], tuple[Path]]:
        # Workers read and write there; it begins and ends here.
        return Folder, (self.folder.absolute(),)

    def close(self) -> None:
        if self._temporary:
            self._temporary.cleanup()

    def discard(self) -> None:
        """Removes the folder: the bake is done."""
        self.close()
        shutil.rmtree(self.folder, ignore_errors=True)


def _fingerprint_in(manifest: Path) -> str | None:
    try:
        return json.loads(manifest.read_text())["fingerprint"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
