"""What a stopped compression has found so far: one small file of labels."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from torchprt.checkpoint import CheckpointWarning, fingerprint
from torchprt.errors import InputError
from torchprt.files import CannotWrite, atomic, check_writable

_KIND = "checkpoint of a compression"
# Seconds between two writings, at least.
_EVERY = 10.0


class Checkpoint:
    """Named entries of tensors, kept in one file while the block that it is a context of runs.

    Written at most every ten seconds, and when the block is interrupted; removed when it ends, or ends with an
    InputError, unless it is to `keep` the file. `tensors` and `parameters` are all that decides the result: a file of
    other ones is not used, with a CheckpointWarning. Without a `path` nothing is kept.

    Raises InputError if the file is anything but a checkpoint of a compression, or cannot be written.
    """

    def __init__(
        self,
        path: str | os.PathLike[str] | None = None,
        tensors: Sequence[Tensor] = (),
        parameters: dict[str, object] | None = None,
        *,
        keep: bool = False,
    ):
        self.path = None if path is None else Path(path)
        self._keep = keep
        self._entries: dict[str, dict[str, Tensor]] = {}
        self._saved, self._ours = time.monotonic(), False
        if self.path is None:
            return
        check_writable(self.path, (self.path.suffix.lower(),))
        self._fingerprint = fingerprint(tensors, parameters or {})
        if self.path.exists():
            found, entries = _read(self.path, str(tensors[0].device) if tensors else "cpu")
            self._ours = found == self._fingerprint
            if self._ours:
                self._entries = entries
            else:
                warnings.warn(
                    f"{self.path} is of a compression of other data or with other parameters: it is not used, this "
                    "compression starts from the beginning",
                    CheckpointWarning,
                    stacklevel=3,
                )

    def __enter__(self) -> Checkpoint:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.path is None:
            return
        if isinstance(fault, KeyboardInterrupt) or (fault is None and self._keep):
            self._save()
        elif isinstance(fault, CannotWrite):
            # What was kept before is what the work goes on from once there is room.
            return
        elif fault is None or (isinstance(fault, InputError) and self._ours):
            self.path.unlink(missing_ok=True)

    def get(self, name: str) -> dict[str, Tensor]:
        """The tensors of an entry; none if it is not there."""
        return dict(self._entries.get(name, {}))

    def put(self, name: str, tensors: dict[str, Tensor]) -> None:
        """Keeps an entry, in place of an earlier one of that name. Integers are kept in 32 bits."""
        if self.path is not None:
            self._entries[name] = tensors
            if time.monotonic() - self._saved >= _EVERY:
                self._save()

    def drop(self, start: str) -> None:
        """Forgets all entries whose name starts so."""
        self._entries = {name: entry for name, entry in self._entries.items() if not name.startswith(start)}

    def _save(self) -> None:
        if self.path is None or not self._entries:
            return
        contents = {
            f"{name}/{part}": (tensor if tensor.is_floating_point() else tensor.to(torch.int32)).cpu().contiguous()
            for name, tensors in self._entries.items()
            for part, tensor in tensors.items()
        }
        # Two entries may hold the same tensor, which the format does not know of.
        contents = {name: tensor.clone() for name, tensor in contents.items()}
        with atomic(self.path) as temporary:
            save_file(contents, temporary, metadata={"kind": _KIND, "fingerprint": self._fingerprint})
        self._saved, self._ours = time.monotonic(), True


def _read(path: Path, device: str) -> tuple[str, dict[str, dict[str, Tensor]]]:
    """Fingerprint and entries of a file, on the device of the data."""
    entries: dict[str, dict[str, Tensor]] = {}
    try:
        with safe_open(path, framework="pt", device=device) as file:
            metadata = file.metadata() or {}
            if metadata.get("kind") != _KIND:
                raise InputError(f"{path} is not a checkpoint of a compression: name another file for the checkpoint")
            for full in file.keys():  # noqa: SIM118
                name, part = full.rsplit("/", 1)
                tensor = file.get_tensor(full)
                # A copy: the file will be replaced.
                entries.setdefault(name, {})[part] = tensor.clone() if tensor.is_floating_point() else tensor.long()
            return metadata.get("fingerprint", ""), entries
    except (SafetensorError, OSError) as fault:
        raise InputError(
            f"{path} is not a checkpoint of a compression ({fault}): remove it, or name another file"
        ) from fault
