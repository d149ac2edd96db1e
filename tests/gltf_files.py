"""glTF files made by hand, part by part, so that tests know every byte of them."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Gltf:
    """A `tree` to fill, and the bytes that its views name."""

    def __init__(self, **tree: Any) -> None:
        self.data = b""
        self.tree: dict[str, Any] = {"asset": {"version": "2.0"}, **tree}
        self.tree |= {"accessors": [], "bufferViews": [], "buffers": [{"byteLength": 0}]}

    def view(self, content: bytes, **entry: Any) -> int:
        """The number of a new view of these bytes."""
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content), **entry}
        self.data += content + b"\0" * (-len(content) % 4)
        self.tree["bufferViews"].append(view)
        self.tree["buffers"][0]["byteLength"] = len(self.data)
        return len(self.tree["bufferViews"]) - 1

    def accessor(self, array: Any, **entry: Any) -> int:
        """The number of a new accessor of this array, [V] or [V, width], of its own type."""
        array = np.asarray(array)
        entry = {"bufferView": self.view(array.tobytes()), **entry} if "bufferView" not in entry else entry
        kind = {"componentType": COMPONENTS[array.dtype.str[1:]], "count": len(array)}
        kind["type"] = SHAPES[array.size // len(array)]
        self.tree["accessors"].append({**kind, **{key: value for key, value in entry.items() if value is not None}})
        return len(self.tree["accessors"]) - 1

    def primitive(self, indices: Any = None, **attributes: Any) -> dict[str, Any]:
        """A primitive of these attributes (arrays, or numbers of accessors) and indices, float64 made float32."""
        entry: dict[str, Any] = {"attributes": {name: self._number(value) for name, value in attributes.items()}}
        return entry if indices is None else {**entry, "indices": self._number(indices)}

    def _number(self, value: Any) -> int:
        if isinstance(value, int):
            return value
        array = np.asarray(value)
        narrow = {"f8": "f4", "i8": "u4"}.get(array.dtype.str[1:], array.dtype.str[1:])
        return self.accessor(array.astype(f"<{narrow}"))

    def glb(self) -> bytes:
        text = json.dumps(self.tree).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        if self.data:
            chunks += struct.pack("<I4s", len(self.data), b"BIN\0") + self.data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def save(self, path: Path) -> Path:
        """Writes a .glb, or a .gltf with its buffer beside it."""
        if path.suffix == ".glb":
            path.write_bytes(self.glb())
            return path
        name = path.with_suffix(".bin").name
        path.with_suffix(".bin").write_bytes(self.data)
        tree = {**self.tree, "buffers": [{"byteLength": len(self.data), "uri": name.replace(" ", "%20")}]}
        path.write_text(json.dumps(tree))
        return path


def draco(file: Gltf, positions: Any, faces: Any, **attributes: Any) -> dict[str, Any]:
    """A primitive of `file` that Draco compressed, in the order given: NORMAL, TEXCOORD_0 and others by name."""
    import DracoPy

    positions, faces = np.asarray(positions, np.float64), np.asarray(faces)
    own = {name: np.asarray(values) for name, values in attributes.items()}
    others = [name for name in own if name not in ("NORMAL", "TEXCOORD_0")]
    content = DracoPy.encode(
        positions,
        faces,
        quantization_bits=20,
        preserve_order=True,
        normals=own.get("NORMAL"),
        tex_coord=own.get("TEXCOORD_0"),
        generic_attributes={100 + number: own[name] for number, name in enumerate(others)} or None,
    )
    ids = {name: 100 + number for number, name in enumerate(others)}
    for each in DracoPy.decode(content).attributes:
        name = {0: "POSITION", 1: "NORMAL", 3: "TEXCOORD_0"}.get(int(each["attribute_type"]))
        if name is not None:
            ids[name] = each["unique_id"]
    file.tree["extensionsUsed"] = file.tree["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    whole = [name for name, values in own.items() if np.issubdtype(values.dtype, np.integer)]
    numbers = {
        name: file.accessor(
            values if name in whole else values.astype("<f4"), bufferView=None, normalized=name in whole or None
        )
        for name, values in {"POSITION": positions, **own}.items()
    }
    indices = file.accessor(faces.reshape(-1).astype("<u4"), bufferView=None)
    packed = {"bufferView": file.view(content), "attributes": ids}
    return {
        "attributes": numbers,
        "indices": indices,
        "extensions": {"KHR_draco_mesh_compression": packed},
    }


def meshopt_view(
    file: Gltf, rows: np.ndarray, mode: str, *, name: str = "EXT_meshopt_compression", filter: str = "NONE"
) -> int:
    """A view of `file` that meshopt compressed: `rows` already filtered, or indices."""
    meshopt = pytest.importorskip("meshopt", reason="meshopt has no package for Python 3.10")

    indices = mode != "ATTRIBUTES"
    size = rows.itemsize * (1 if indices else rows.shape[1])
    content = meshopt.encode_gltf_buffer(rows, mode, int(name.startswith("KHR")))
    packed = file.view(bytes(content))
    part = file.tree["bufferViews"].pop(packed)
    extension = {**part, "byteStride": size, "count": len(rows), "mode": mode, "filter": filter}
    if len(file.tree["buffers"]) == 1:
        file.tree["buffers"].append({"byteLength": 0, "extensions": {name: {"fallback": True}}})
    file.tree["buffers"][1]["byteLength"] += size * len(rows)
    view = {"buffer": 1, "byteOffset": 0, "byteLength": size * len(rows), "extensions": {name: extension}}
    if not indices:
        view["byteStride"] = size
    file.tree["bufferViews"].append(view)
    file.tree["extensionsUsed"] = file.tree["extensionsRequired"] = [name]
    return len(file.tree["bufferViews"]) - 1
