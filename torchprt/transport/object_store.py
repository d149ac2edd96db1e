"""Chunks of a bake in a store that is no folder of this machine: S3 and all else that fsspec opens by its URL."""

from __future__ import annotations

import contextlib
import json
import warnings
from collections.abc import Iterator
from typing import Any

import safetensors.torch
from safetensors import SafetensorError
from torch import Tensor

from torchprt.checkpoint import CheckpointWarning
from torchprt.errors import InputError

_MANIFEST = "manifest.json"


class Objects:
    """Chunks under a URL, an object each: `Results` for all who reach the store. Pickles as the URL.

    A store takes an object whole. Where it does not (a file system over a network), a chunk that was cut off is shorter
    than its header says, and counts as not there.
    """

    def __init__(self, url: str):
        self.url = url.rstrip("/")
        self._files, self._root = _opened(self.url)

    def path(self, number: int) -> str:
        return f"{self._root}/chunk-{number:07d}.safetensors"

    def save(self, number: int, tensors: dict[str, Tensor]) -> None:
        content = safetensors.torch.save({name: tensor.contiguous() for name, tensor in tensors.items()})
        with self._sentences("written"):
            self._files.pipe_file(self.path(number), content)

    def load(self, number: int) -> dict[str, Tensor] | None:
        """The tensors of a chunk, or None if it is not there or was cut off."""
        try:
            with self._sentences("read"):
                return safetensors.torch.load(self._files.cat_file(self.path(number)))
        except (FileNotFoundError, SafetensorError):
            return None

    def read(self, number: int) -> dict[str, Tensor]:
        """The tensors of a chunk that was saved before. Raises InputError if it is not there any more."""
        contents = self.load(number)
        if contents is None:
            raise InputError(
                f"chunk {number} in {self.url} vanished or was damaged during the bake, or is not seen by all "
                "workers: run it again"
            )
        return contents

    @property
    def fingerprint(self) -> str | None:
        """Of the bake that the chunks belong to, None if that is not said."""
        try:
            with self._sentences("read"):
                return json.loads(self._files.cat_file(f"{self._root}/{_MANIFEST}"))["fingerprint"]
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None

    def __str__(self) -> str:
        return self.url

    def __reduce__(self) -> tuple[type[Objects], tuple[str]]:
        return Objects, (self.url,)

    @contextlib.contextmanager
    def _sentences(self, done: str) -> Iterator[None]:
        # Every store has errors of its own.
        try:
            yield
        except (FileNotFoundError, InputError, SafetensorError):
            raise
        except Exception as fault:
            raise InputError(
                f"{self.url} cannot be {done} ({str(fault) or type(fault).__name__}): look to its rights and room, or "
                "name another checkpoint"
            ) from fault


class ObjectCheckpoint(Objects):
    """As `Checkpoint`, under a URL."""

    def __init__(self, url: str, fingerprint: str):
        super().__init__(url)
        with self._sentences("written"):
            self._files.invalidate_cache()
            self._files.makedirs(self._root, exist_ok=True)
            names = self._names()
        strangers = [name for name in names if not name.startswith("chunk-") and name != _MANIFEST]
        if strangers:
            raise InputError(f"{self.url} holds other files ({strangers[0]}): name another checkpoint")
        known = self.fingerprint
        if names and known != fingerprint:
            warnings.warn(
                f"{self.url} is of a bake with another scene or other parameters: it is emptied, this bake starts from "
                "the beginning",
                CheckpointWarning,
                stacklevel=3,
            )
            with self._sentences("written"):
                self._files.rm([f"{self._root}/{name}" for name in names])
        if known != fingerprint:
            with self._sentences("written"):
                content = json.dumps({"fingerprint": fingerprint}).encode()
                self._files.pipe_file(f"{self._root}/{_MANIFEST}", content)

    def _names(self) -> list[str]:
        try:
            found = self._files.ls(self._root, detail=False)
        except FileNotFoundError:
            return []
        # Some stores list the folder in itself.
        names = [str(each).rstrip("/").rpartition("/")[2] for each in found]
        return sorted(name for name in names if name != self._root.rpartition("/")[2])

    def close(self) -> None:
        """Nothing is held open."""

    def discard(self) -> None:
        """Removes the folder: the bake is done."""
        remove(self.url)


def remove(url: str) -> None:
    """Removes a checkpoint of a bake that is done; what cannot be removed stays."""
    files, root = _opened(url.rstrip("/"))
    with contextlib.suppress(Exception):
        files.rm(root, recursive=True)


def _opened(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it. InputError if there is none, or it does not open."""
    try:
        import fsspec
    except ImportError:
        raise InputError(
            f"{url} is opened by fsspec, which is not installed: `pip install 'torchprt[cluster]'`, or name a folder"
        ) from None
    try:
        files, root = fsspec.core.url_to_fs(url)
    except Exception as fault:
        # A protocol that nobody knows, a package that is missing, rights that are.
        raise InputError(f"the checkpoint {url} cannot be opened ({fault}): name another, or a folder") from fault
    return files, str(root)
