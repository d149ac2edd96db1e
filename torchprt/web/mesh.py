"""The mesh of a page, small: places in 16 bits, normals and colours in 8 and 16, what meshopt makes of them."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.version import VERSION

# Of the specification of glTF 2.0 and its extensions: component types, buffer targets.
SHORT, UNSIGNED_SHORT, UNSIGNED_INT = 5122, 5123, 5125
VERTICES, INDICES = 34962, 34963
MOST = 65535
# Bits of a coordinate of a normal on the octahedron: 0.1 degrees at most.
NORMAL_BITS = 11


def save_small_glb(
    positions: Float[Tensor, "V 3"],
    normals: Float[Tensor, "V 3"],
    faces: Tensor,
    path: Path,
    *,
    colour: Float[Tensor, "V 3"],
) -> float:
    """Writes one mesh as `.glb`, vertices in their order; gives by how much places are off, at most, in its unit.

    Positions are whole numbers of 16 bits that the node scales, the same in all directions, and colours linear RGB of
    16 bits (KHR_mesh_quantization). Each stream is packed by meshoptimizer (EXT_meshopt_compression), the normals in
    octahedral form; where its encoder is not installed (Python 3.10), they are written as they are.
    Faces keep the sense of their corners, not their order, nor which corner comes first.
    Source: the specification of glTF 2.0 and of these two extensions.
    """
    places = positions.detach().double().numpy()
    low = places.min(0)
    step = float((places.max(0) - low).max()) / MOST or 1.0
    stored = np.rint((places - low) / step)
    length = torch.linalg.vector_norm(normals.double(), dim=-1, keepdim=True)
    unit = torch.where(length > 0, normals.double() / torch.where(length > 0, length, 1.0), torch.tensor([0.0, 1, 0]))
    content = _Content()
    bounds = {"min": stored.min(0).tolist(), "max": stored.max(0).tolist()}
    attributes = {
        "POSITION": content.rows(_padded(stored, np.uint16), UNSIGNED_SHORT, False, bounds),
        "NORMAL": content.normals(unit.numpy()),
        "COLOR_0": content.rows(_padded(_whole(colour), np.uint16), UNSIGNED_SHORT, True),
    }
    used = ["KHR_mesh_quantization", *(["EXT_meshopt_compression"] if content.packs else [])]
    tree: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"torchprt {VERSION}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [step] * 3, "translation": low.tolist()}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": content.faces(faces.numpy())}]}],
        "extensionsUsed": used,
        "extensionsRequired": used,
        "accessors": content.accessors,
        "bufferViews": content.views,
        "buffers": [{"byteLength": content.size}],
    }
    if content.packs:
        # What the streams would be without their packing, which is nowhere.
        tree["buffers"].append(
            {"byteLength": content.unpacked, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
        )
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + content.size
    with path.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", content.size, b"BIN\0"))
        file.writelines(content.parts)
    return float(np.abs(stored * step + low - places).max())


def _whole(colour: Tensor) -> np.ndarray:
    return np.rint(colour.detach().double().clamp(0, 1).numpy() * MOST)


def _padded(values: np.ndarray, kind: Any) -> np.ndarray:
    """`[V, 3]` as rows of four, as glTF aligns them."""
    return np.concatenate([values, np.zeros((len(values), 1))], 1).astype(np.dtype(kind).newbyteorder("<"))


class _Content:
    """The binary part: streams one after the other, each a view and an accessor."""

    def __init__(self) -> None:
        try:
            import meshopt
        except ImportError:
            meshopt = None
        self.packs = meshopt
        self.size = self.unpacked = 0
        self.parts: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def rows(self, rows: np.ndarray, kind: int, normalised: bool, bounds: dict[str, Any] | None = None) -> int:
        """The number of the accessor of the first three of the columns."""
        packed = self.packs.encode_gltf_buffer(rows, "ATTRIBUTES") if self.packs else None
        return self._stream(
            rows, packed, {"mode": "ATTRIBUTES"}, kind, "VEC3", {"normalized": normalised} | (bounds or {})
        )

    def normals(self, unit: np.ndarray) -> int:
        """As normalised numbers of 16 bits."""
        rows = _padded(np.rint(unit * 32767), np.int16)
        packed = None
        if self.packs:
            wide = np.concatenate([unit, np.zeros((len(unit), 1))], 1)
            packed = self.packs.encode_gltf_buffer(self.packs.encode_filter_oct(wide, 8, NORMAL_BITS), "ATTRIBUTES")
        how = {"mode": "ATTRIBUTES", "filter": "OCTAHEDRAL"}
        return self._stream(rows, packed, how, SHORT, "VEC3", {"normalized": True})

    def faces(self, faces: np.ndarray) -> int:
        indices = faces.astype("<u4").ravel()
        packed = None
        if self.packs:
            # Neighbours one after the other, of which meshopt makes half as many bytes; vertices keep their numbers.
            ordered, place, used = self.packs.reorder_mesh(indices, True, True)
            (known,) = np.nonzero(place < used)
            number = np.empty(used, np.uint32)
            number[place[known]] = known
            packed = self.packs.encode_gltf_buffer(number[ordered], "TRIANGLES")
        return self._stream(indices[:, None], packed, {"mode": "TRIANGLES"}, UNSIGNED_INT, "SCALAR", {})

    def _stream(
        self, rows: np.ndarray, packed: bytes | None, how: dict[str, str], kind: int, shape: str, more: dict[str, Any]
    ) -> int:
        stride = rows.shape[1] * rows.itemsize
        part = rows.tobytes() if packed is None else packed
        view: dict[str, Any] = {
            "buffer": 0 if packed is None else 1,
            "byteOffset": self.size if packed is None else self.unpacked,
            "byteLength": rows.nbytes,
        }
        if shape == "SCALAR":
            view["target"] = INDICES
        else:
            view |= {"target": VERTICES, "byteStride": stride}
        if packed is not None:
            where = {"buffer": 0, "byteOffset": self.size, "byteLength": len(part), "byteStride": stride}
            view["extensions"] = {"EXT_meshopt_compression": {**where, "count": len(rows), **how}}
            self.unpacked += rows.nbytes
        self.views.append(view)
        accessor = {"bufferView": len(self.views) - 1, "componentType": kind, "count": len(rows), "type": shape}
        self.accessors.append(accessor | more)
        self.parts.append(part + b"\0" * (-len(part) % 4))
        self.size += len(self.parts[-1])
        return len(self.accessors) - 1
