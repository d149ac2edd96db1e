"""What a bake returns: transfer with the geometry that draws it."""

from __future__ import annotations

import dataclasses
from typing import Any

import torch
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.transfer import Dense, Diffuse, Transfer, Vertices
from torchprt.transport.validity import Validity
from torchprt.version import VERSION


def diffuse(geometry: Geometry, vectors: Tensor, validity: Validity | None = None, **metadata: Any) -> Transfer:
    """Diffuse transfer of the receivers of a scene."""
    layer = Diffuse(albedo=uniform(geometry.albedo), signal=Dense(values=vectors))
    receivers = vertices(geometry, validity)
    return Transfer(receivers=receivers, layers={"diffuse": layer}, version=VERSION, **metadata)


def vertices(geometry: Geometry, validity: Validity | None = None) -> Vertices:
    """The receivers of a scene, of which objects they are, and how they see unless all are valid."""
    found = _where(geometry.receiver_positions, geometry.receiver_normals, geometry.display_faces)
    sides = (("front", geometry.slices), ("back", geometry.back_slices))
    objects = [
        {"name": name, "role": role, "side": side, "rows": [rows.start, rows.stop]}
        for side, slices in sides
        for name, role, rows in zip(geometry.names, geometry.roles, slices, strict=True)
        if rows.stop > rows.start
    ]
    sight = None if validity is None or not bool(validity.sight.any()) else validity.sight
    return dataclasses.replace(found, objects=objects, sight=sight, **_mirrors(geometry))


def _mirrors(geometry: Geometry) -> dict[str, Tensor]:
    """The mirrors of a scene as they are drawn, vertices of no mirror left out."""
    shining = geometry.mirror >= 0
    if not bool(shining.any()):
        return {}
    faces = geometry.faces[shining]
    used, corners = torch.unique(faces, return_inverse=True)
    of_vertex = torch.zeros(len(used), dtype=torch.int64)
    of_vertex[corners.flatten()] = geometry.mirror[shining].repeat_interleave(3)
    return {
        "mirror_positions": single(geometry.positions[used]),
        "mirror_normals": geometry.mirror_normals[used].to(torch.float32),
        "mirror_reflectance": geometry.reflectance[of_vertex].expand(-1, 3).contiguous(),
        "mirror_faces": corners.to(torch.int32),
    }


def uniform(weights: Tensor) -> Tensor:
    """One row if all rows are equal."""
    alike = len(weights) > 0 and bool((weights == weights[0]).all())
    return weights[:1].clone() if alike else weights


def _where(positions: Tensor, normals: Tensor, faces: Tensor) -> Vertices:
    return Vertices(positions=single(positions), normals=normals.to(torch.float32), faces=faces.to(torch.int32))


def single(positions: Tensor) -> Tensor:
    """In float32 if that says the same: a scan comes so, and twice the bytes would say nothing more."""
    single = positions.to(torch.float32)
    return single if bool((single.to(torch.float64) == positions).all()) else positions
