"""A model as binary glTF whose values are exactly those given: linear colours in float32, own attributes, unlit."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.version import VERSION

# Of the specification of glTF 2.0: component types, buffer targets, primitive modes.
FLOAT, UNSIGNED_INT = 5126, 5125
VERTICES, INDICES = 34962, 34963
POINTS, TRIANGLES = 0, 4
LARGEST = 2**32 - 1
PLAIN = {
    "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1], "metallicFactor": 0, "roughnessFactor": 1},
    "extensions": {"KHR_materials_unlit": {}},
}
"""The material of colours that are shown as they are."""


def save_glb(
    positions: Float[Tensor, "V 3"],
    normals: Float[Tensor, "V 3"],
    faces: Tensor,
    path: str | os.PathLike[str],
    *,
    colour: Float[Tensor, "V 3"] | None = None,
    attributes: Mapping[str, Tensor] | None = None,
    extras: Mapping[str, Any] | None = None,
) -> None:
    """Writes one mesh (points without `faces [F, 3]`) as `.glb`, vertices in their order, everything in float32.

    `colour`: linear RGB, `COLOR_0`; the material is unlit (KHR_materials_unlit), so viewers show it as it is.
    `attributes`: further values a vertex, `[V, 1 to 4]`, under names that begin with an underscore. `extras`: JSON
    about the mesh. Where a normal is zero the file has +y, as glTF allows no other length than 1.

    Raises InputError without vertices, if `path` cannot be written, or if the values take more than 4 GB.
    Source: the specification of glTF 2.0, sections 3.6, 3.7 and 4.
    """
    if len(positions) == 0:
        raise InputError(f"{path} would have no vertices, which glTF does not allow: give a model that has some")
    values = {"POSITION": positions, "NORMAL": unit_normals(normals)}
    if colour is not None:
        values["COLOR_0"] = colour
    values |= attributes or {}
    content = _Content()
    primitive: dict[str, Any] = {
        "attributes": {
            name: content.add(_array(value, np.float32), name == "POSITION") for name, value in values.items()
        },
        "mode": TRIANGLES if len(faces) else POINTS,
        "material": 0,
    }
    if len(faces):
        primitive["indices"] = content.add(_array(faces, np.uint32).reshape(-1, 1))
    mesh = {"primitives": [primitive]} | ({"extras": dict(extras)} if extras else {})
    tree = {
        "asset": {"version": "2.0", "generator": f"torchprt {VERSION}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [mesh],
        "materials": [PLAIN],
        "extensionsUsed": ["KHR_materials_unlit"],
        "accessors": content.accessors,
        "bufferViews": content.views,
        "buffers": [{"byteLength": content.size}],
    }
    text = json.dumps(tree, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + content.size
    if total > LARGEST:
        raise InputError(f"{path} would have {total / 2**30:.1f} GB, more than the 4 GB of a .glb: split the scene")
    with atomic(Path(path)) as temporary, temporary.open("wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, total))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", content.size, b"BIN\0"))
        file.writelines(content.parts)


def unit_normals(normals: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
    """Of length one, float64; +y where there is none, as glTF allows no other length."""
    length = torch.linalg.vector_norm(normals.double(), dim=-1, keepdim=True)
    up = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64)
    return torch.where(length > 0, normals.double() / torch.where(length > 0, length, 1.0), up)


class _Content:
    """The binary part: arrays one after the other, each a view and an accessor."""

    def __init__(self) -> None:
        self.size = 0
        self.parts: list[bytes] = []
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, array: np.ndarray, bounds: bool = False) -> int:
        """The number of the accessor. All components have four bytes, so everything stays aligned."""
        index = array.dtype == np.uint32
        part = array.tobytes()
        self.views.append(
            {
                "buffer": 0,
                "byteOffset": self.size,
                "byteLength": len(part),
                "target": INDICES if index else VERTICES,
            }
        )
        kind = "SCALAR" if array.shape[1] == 1 else f"VEC{array.shape[1]}"
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": UNSIGNED_INT if index else FLOAT,
            "count": len(array),
            "type": kind,
        }
        if bounds:
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        self.parts.append(part)
        self.size += len(part)
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _array(value: Tensor, dtype: type) -> np.ndarray:
    return np.ascontiguousarray(value.detach().cpu().numpy().astype(dtype).astype(np.dtype(dtype).newbyteorder("<")))
