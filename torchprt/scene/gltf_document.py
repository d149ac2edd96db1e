"""A .glb or .gltf file: its JSON tree, and the bytes and arrays that the tree names."""

import base64
import binascii
import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote, unquote_to_bytes

import numpy as np

from torchprt.errors import InputError
from torchprt.suffixes import check_readable

from .gltf_decode import MESHOPT, decode_meshopt

# Section 3.6.2 of the specification of glTF 2.0.
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
LARGEST_ZEROS = 2**27
"""Numbers of an accessor that has no data: more is a damaged count."""

KNOWN = (
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
    "EXT_mesh_gpu_instancing",
    "KHR_animation_pointer",
    "KHR_node_",
    "KHR_xmp",
    # These change how a surface looks, never where it is.
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
    "EXT_lights_",
)
"""Beginnings of the names of extensions that a file may require."""


class Document:
    """The `tree` of a .glb or .gltf as it stands in the file, and what it names, resolved when asked for.

    `source` names the file in messages, and its folder holds the files that the tree names.
    Raises InputError if the file is cut short, not glTF 2.0, or requires an extension that is not known.
    Source: the specification of glTF 2.0, sections 3 and 4.
    """

    def __init__(self, data: bytes, source: str | os.PathLike[str]) -> None:
        self.source = Path(source)
        text, self._chunk = _split(data, self.source)
        tree = json.loads(text)
        if not isinstance(tree, dict) or "asset" not in tree:
            raise InputError(f"{self.source} is not a glTF file: export the mesh again")
        self.tree: dict[str, Any] = tree
        version = str(tree["asset"].get("version"))
        if version.split(".")[0] != "2":
            raise InputError(f"{self.source} is glTF {version}: convert it to glTF 2.0")
        for name in tree.get("extensionsRequired", ()):
            if not name.startswith(KNOWN):
                raise InputError(f"{self.source} requires {name}, which is not read: export the mesh without it")
        self._buffers: dict[int, bytes] = {}
        self._views: dict[int, bytes] = {}

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "Document":
        """The document of a file. Raises InputError, naming it, if it does not exist or is damaged."""
        source = check_readable(path)
        try:
            content = source.read_bytes()
        except OSError as fault:
            raise InputError(f"{source} cannot be read ({fault.strerror}): check the name") from fault
        with whole(source):
            return cls(content, source)

    def all(self, name: str) -> list[dict[str, Any]]:
        """The entries of the tree under `name`, "meshes" or "nodes"; none if the file has none."""
        found: list[dict[str, Any]] = self.tree.get(name, [])
        return found

    def entry(self, name: str, number: Any) -> dict[str, Any]:
        """The entry `number` of the tree under `name`. Raises InputError if it does not exist."""
        entries = self.all(name)
        # Python counts back from the end below zero; glTF does not.
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(entries):
            raise InputError(f"{self.source} names {name} {number} of {len(entries)}: export the mesh again")
        return entries[number]

    def buffer(self, number: int) -> bytes:
        """The bytes of a buffer: the chunk of a .glb, a data URI, or a file beside it."""
        if number not in self._buffers:
            entry = self.entry("buffers", number)
            if "uri" in entry:
                content = self.resolve(entry["uri"])[0]
            elif number == 0 and self._chunk is not None:
                content = self._chunk
            else:
                raise InputError(f"{self.source} has no data for buffer {number}: export the mesh again")
            if len(content) < entry["byteLength"]:
                raise InputError(
                    f"{self.source} is cut short, {len(content)} of {entry['byteLength']} bytes of buffer {number}: "
                    "export the mesh again"
                )
            self._buffers[number] = content
        return self._buffers[number]

    def resolve(self, uri: str) -> tuple[bytes, str]:
        """Bytes and MIME type (empty if unknown) of a data URI or of a file beside the document.

        Raises InputError if the file does not exist, or if the address is of another kind.
        """
        if uri.startswith("data:"):
            head, found, body = uri[5:].partition(",")
            kind, *options = head.split(";")
            try:
                content = base64.b64decode(body, validate=True) if "base64" in options else unquote_to_bytes(body)
            except binascii.Error as fault:
                raise InputError(f"{self.source} has a damaged data URI ({fault}): export the mesh again") from fault
            if not found:
                raise InputError(f"{self.source} has a data URI without data: export the mesh again")
            return content, kind
        if "://" in uri:
            raise InputError(f"{self.source} names {uri}: download it and name the file beside the mesh")
        path = self.source.parent / unquote(uri)
        if path.exists():
            check_readable(path)
        try:
            return path.read_bytes(), ""
        except FileNotFoundError as fault:
            raise InputError(
                f"{self.source} names {path}, which does not exist: copy or export the mesh again"
            ) from fault
        except OSError as fault:
            raise InputError(f"{self.source} names {path}, which cannot be read ({fault.strerror})") from fault

    def view(self, number: int) -> bytes:
        """The bytes of a buffer view, decompressed if it is compressed with meshopt."""
        if number not in self._views:
            entry = self.entry("bufferViews", number)
            packed = next(
                (entry.get("extensions", {})[name] for name in MESHOPT if name in entry.get("extensions", {})), None
            )
            if packed is None:
                self._views[number] = self._part(entry, f"buffer view {number}")
            else:
                part = self._part(packed, f"buffer view {number}")
                self._views[number] = decode_meshopt(part, packed, self.source)
        return self._views[number]

    def accessor(self, number: int) -> np.ndarray:
        """The values of an accessor, `[count, width]`: float64 if they are normalised, else of the type in the file.

        A value of a matrix is a row of its columns. Without a buffer view all are zero but for those that a sparse
        accessor replaces.
        Raises InputError if it reads beyond its buffer view.
        """
        entry = self.entry("accessors", number)
        kind, width, count = np.dtype(COMPONENTS[entry["componentType"]]), WIDTHS[entry["type"]], entry["count"]
        if "bufferView" in entry:
            stride = self.entry("bufferViews", entry["bufferView"]).get("byteStride", 0)
            values = self._values(entry["bufferView"], entry.get("byteOffset", 0), stride, count, width, kind, number)
        elif 0 <= count <= LARGEST_ZEROS // width:
            values = np.zeros((count, width), kind)
        else:
            raise InputError(f"{self.source} has accessor {number} of {count} values: export the mesh again")
        sparse = entry.get("sparse")
        if sparse:
            values = values.copy()
            where, what = sparse["indices"], sparse["values"]
            whole = np.dtype(COMPONENTS[where["componentType"]])
            at = self._values(where["bufferView"], where.get("byteOffset", 0), 0, sparse["count"], 1, whole, number)
            values[at[:, 0]] = self._values(
                what["bufferView"], what.get("byteOffset", 0), 0, sparse["count"], width, kind, number
            )
        return normalised(values, entry)

    def image(self, number: int) -> tuple[bytes, str]:
        """Bytes and MIME type of an image as the file has it, not decoded; the type is told from the bytes if need be.

        Raises InputError if the file that it names does not exist.
        """
        entry = self.entry("images", number)
        with whole(self.source):
            content, said = self.resolve(entry["uri"]) if "uri" in entry else (self.view(entry["bufferView"]), "")
            return content, entry.get("mimeType") or said or mime_type(content)

    def _part(self, entry: Mapping[str, Any], what: str) -> bytes:
        start, length = entry.get("byteOffset", 0), entry["byteLength"]
        content = self.buffer(entry["buffer"])
        if not 0 <= start <= start + length <= len(content):
            raise InputError(f"{self.source} is cut short, {what} ends behind its buffer: export the mesh again")
        return content[start : start + length]

    def _values(
        self, view: int, start: int, stride: int, count: int, width: int, kind: np.dtype, number: int
    ) -> np.ndarray:
        content = self.view(view)
        size = width * kind.itemsize
        stride = stride or size
        if count < 0 or start < 0 or stride < size or (count and start + stride * (count - 1) + size > len(content)):
            raise InputError(
                f"{self.source} is cut short, accessor {number} ends behind its buffer view: export the mesh again"
            )
        return np.ndarray((count, width), kind, content, start, (stride, kind.itemsize))


@contextlib.contextmanager
def whole(source: Path) -> Iterator[None]:
    """Faults met in the block are those of a damaged file, in which anything may be missing or of the wrong type."""
    try:
        yield
    except InputError:
        raise
    except Exception as fault:
        said = (str(fault).strip().splitlines() or [""])[0][:100]
        raise InputError(
            f"{source} is damaged or not glTF ({type(fault).__name__} {said}): export the mesh again"
        ) from fault


def normalised(values: np.ndarray, accessor: Mapping[str, Any]) -> np.ndarray:
    """Whole numbers as the numbers in [0, 1] or [-1, 1] that they stand for, if `accessor` says that they do."""
    if not accessor.get("normalized") or not np.issubdtype(values.dtype, np.integer):
        return values
    largest = np.iinfo(COMPONENTS[accessor["componentType"]]).max
    return np.maximum(values / np.float64(largest), -1.0)


def as_declared(values: np.ndarray, accessor: Mapping[str, Any]) -> np.ndarray:
    """Decoded values in the type that `accessor` says they have: Draco may hold whole numbers as others."""
    kind = np.dtype(COMPONENTS[accessor["componentType"]])
    if np.issubdtype(kind, np.integer) and np.issubdtype(values.dtype, np.floating):
        limits = np.iinfo(kind)
        values = np.rint(values).clip(limits.min, limits.max)
    return values.astype(kind)


def mime_type(content: bytes) -> str:
    """What kind of picture begins like this; empty if none that glTF may hold."""
    starts = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"\xabKTX 20": "image/ktx2"}
    for start, kind in starts.items():
        if content.startswith(start):
            return kind
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return "image/webp"
    return "image/avif" if content[4:12] == b"ftypavif" else ""


def _split(data: bytes, source: Path) -> tuple[bytes, bytes | None]:
    """The JSON text and, of a .glb, its binary chunk."""
    if data[:4] != b"glTF":
        if source.suffix.lower() == ".glb":
            raise InputError(f"{source} is not a .glb file: export the mesh again")
        return data, None
    version, total = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
    if version != 2:
        raise InputError(f"{source} is glTF {version}: convert it to glTF 2.0")
    if len(data) < total or total < 20:
        raise InputError(f"{source} is cut short, {len(data)} of {total} bytes: export the mesh again")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= total:
        length, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        if at + 8 + length > total:
            raise InputError(f"{source} is cut short in its chunk of {length} bytes: export the mesh again")
        chunks.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length
    if b"JSON" not in chunks:
        raise InputError(f"{source} has no JSON: export the mesh again")
    return chunks[b"JSON"], chunks.get(b"BIN\0")
