"""A glTF document written again as one .glb: everything it had, uncompressed, and arrays that are new."""

from __future__ import annotations

import copy
import json
import os
import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.scene.gltf import DRACO, MESHOPT, Document, as_declared, decode_draco, mime_type
from torchprt.version import VERSION

LARGEST = 2**32 - 1
VERTICES, INDICES = 34962, 34963
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


class AssetWarning(UserWarning):
    """Something of an asset cannot be kept."""


class AssetFile:
    """The `tree` of a document, free to change, over one binary chunk that holds all its buffers.

    Numbers of buffer views, accessors, images and all else stay what they were; new ones follow. Buffer views of
    meshopt and primitives of Draco are written uncompressed, and pictures that stood beside the file or in its text
    are in the chunk; one that is not there stays a name, which a warning (`AssetWarning`) says.
    Raises InputError as `Document` does where the file is damaged.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        self.tree: dict[str, Any] = copy.deepcopy(document.tree)
        self._parts: list[bytes] = []
        self._size = 0
        self._packed: dict[tuple[int, str], int] = {}
        self._free = sorted({packed["bufferView"] for _, packed in self._draco()})
        for number, view in enumerate(self._list("bufferViews")):
            if number not in self._free:
                self._place(view, document.view(number))
        self._unpack()
        self._embed()
        used = [name for name in self.tree.get("extensionsUsed", ()) if name not in (DRACO, *MESHOPT)]
        self.require(used, [name for name in self.tree.get("extensionsRequired", ()) if name in used])

    def add(self, name: str, entry: Any) -> int:
        """The number of a new entry of the tree under `name`, "nodes" or "materials"."""
        self._list(name).append(entry)
        return len(self.tree[name]) - 1

    def accessor(self, array: np.ndarray, *, indices: bool = False, bounds: bool = False) -> int:
        """The number of a new accessor of the rows of `array [V, width]`; POSITION needs `bounds`."""
        return self.add("accessors", self._described(array, indices, bounds))

    def picture(self, content: bytes, kind: str) -> int:
        """The number of a new image, of a file of the MIME type `kind`."""
        view: dict[str, Any] = {}
        self._place(view, content)
        return self.add("images", {"bufferView": self._view(view), "mimeType": kind})

    def extend(self, name: str) -> None:
        """Says that the file uses an extension."""
        used = self.tree.get("extensionsUsed", [])
        self.require(used if name in used else [*used, name], self.tree.get("extensionsRequired", []))

    def require(self, used: list[str], required: list[str]) -> None:
        """Which extensions the file uses and which it requires; an empty list is not allowed, and left out."""
        for key, names in (("extensionsUsed", used), ("extensionsRequired", required)):
            self.tree.pop(key, None)
            if names:
                self.tree[key] = names

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the .glb. Raises InputError if `path` cannot be written or the file would have more than 4 GB."""
        total, lead = self._lead()
        if total > LARGEST:
            raise InputError(f"{path} would have {total / 2**30:.1f} GB, more than the 4 GB of a .glb: split the model")
        with atomic(Path(path)) as temporary, temporary.open("wb") as file:
            file.write(struct.pack("<4sII", b"glTF", 2, total) + lead)
            file.writelines(self._parts)

    def content(self) -> bytes:
        """The .glb as it stands."""
        total, lead = self._lead()
        return b"".join([struct.pack("<4sII", b"glTF", 2, min(total, LARGEST)) + lead, *self._parts])

    def _lead(self) -> tuple[int, bytes]:
        """Bytes of the whole file, and what stands in it between its header and the arrays."""
        # The standard wants four bytes of everything that is there at all.
        self.tree["buffers"] = [{"byteLength": self._size}]
        self.tree["asset"] = {**self.tree["asset"], "generator": self._generator()}
        text = json.dumps(self.tree, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        lead = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", self._size, b"BIN\0")
        return 12 + len(lead) + self._size, lead

    def _generator(self) -> str:
        """Who made the asset, and that it went through here."""
        own, before = f"torchprt {VERSION}", str(self.document.tree["asset"].get("generator", ""))
        return before if own in before else f"{before}, {own}" if before else own

    def _list(self, name: str) -> list[Any]:
        found: list[Any] = self.tree.setdefault(name, [])
        return found

    def _draco(self) -> list[tuple[dict[str, Any], dict[str, Any]]]:
        """Every primitive that Draco compressed, and its extension."""
        all = [entry for mesh in self.tree.get("meshes", ()) for entry in mesh["primitives"]]
        return [(entry, entry["extensions"][DRACO]) for entry in all if DRACO in entry.get("extensions", {})]

    def _unpack(self) -> None:
        source = self.document.source
        decoded = {view: decode_draco(self.document.view(view), source) for view in self._free}
        for entry, packed in self._draco():
            view, here = packed["bufferView"], decoded[packed["bufferView"]]
            for name, number in entry["attributes"].items():
                if name in packed["attributes"]:
                    values = here.attributes[packed["attributes"][name]]
                    entry["attributes"][name] = self._fill(number, values, (view, name))
            # Draco has no strips: what was one comes out as triangles.
            entry["mode"] = 4
            count = len(next(iter(here.attributes.values())))
            narrow = here.indices.astype("<u2" if count < 2**16 else "<u4").reshape(-1, 1)
            if "indices" in entry:
                entry["indices"] = self._fill(entry["indices"], narrow, (view, ""))
            else:
                entry["indices"] = self.accessor(narrow, indices=True)
            del entry["extensions"][DRACO]
            if not entry["extensions"]:
                del entry["extensions"]

    def _fill(self, number: int, values: np.ndarray, of: tuple[int, str]) -> int:
        """The accessor `number` with these values in it, or a new one if others are there already."""
        if of not in self._packed:
            entry = self.tree["accessors"][number]
            index = not of[1]
            rows = values if index else as_declared(values, entry)
            made = self._described(rows, index, "min" in entry and not index)
            if "bufferView" in entry:
                number = self.add("accessors", {**entry, **made})
            else:
                entry.update(made)
            self._packed[of] = number
        return self._packed[of]

    def _embed(self) -> None:
        for number, image in enumerate(self.tree.get("images", ())):
            if "uri" not in image or "://" in image["uri"]:
                continue
            try:
                content = self.document.image(number)[0]
                kind = mime_type(content)
                if not kind:
                    # A file that a picture names may be any file of this machine.
                    raise InputError(f"{self.document.source} names {image['uri'][:80]}, which is no picture")
            except InputError as fault:
                warnings.warn(f"{fault}; the picture is left out", AssetWarning, stacklevel=2)
                continue
            del image["uri"]
            view: dict[str, Any] = {}
            self._place(view, content)
            image |= {"bufferView": self._view(view), "mimeType": kind}

    def _described(self, array: np.ndarray, indices: bool, bounds: bool) -> dict[str, Any]:
        """An accessor of these rows. Those of vertices begin at multiples of four bytes, as the standard asks."""
        size = array.itemsize * array.shape[1]
        padded = size if indices else -(-size // 4) * 4
        rows = np.zeros((len(array), padded), np.uint8)
        rows[:, :size] = np.ascontiguousarray(array).view(np.uint8).reshape(len(array), size)
        view: dict[str, Any] = {"target": INDICES if indices else VERTICES}
        if not indices:
            view["byteStride"] = padded
        self._place(view, rows.tobytes())
        entry = {
            "bufferView": self._view(view),
            "componentType": COMPONENTS[array.dtype.str[1:]],
            "count": len(array),
            "type": SHAPES[array.shape[1]],
        }
        return entry | ({"min": array.min(0).tolist(), "max": array.max(0).tolist()} if bounds else {})

    def _view(self, view: dict[str, Any]) -> int:
        """The number of a new view, which takes the place of one that is not needed any more."""
        if self._free:
            number = self._free.pop(0)
            self.tree["bufferViews"][number] = view
            return number
        return self.add("bufferViews", view)

    def _place(self, view: dict[str, Any], content: bytes) -> None:
        """These bytes as those of `view`, at the end of the chunk."""
        extensions = {key: value for key, value in view.get("extensions", {}).items() if key not in MESHOPT}
        view.pop("extensions", None)
        view |= {"buffer": 0, "byteOffset": self._size, "byteLength": len(content)}
        if extensions:
            view["extensions"] = extensions
        padded = content + b"\0" * (-len(content) % 4)
        self._parts.append(padded)
        self._size += len(padded)
