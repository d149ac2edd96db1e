"""What a bake returns: transfer with the geometry that draws it."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from torchprt.scene import Geometry, Points
from torchprt.transfer import DiffuseTransfer
from torchprt.version import VERSION


def diffuse(geometry: Geometry, points: Points | None, transfer: Tensor, **metadata: Any) -> DiffuseTransfer:
    """Transfer of the receivers of a scene, or of points in it."""
    if points is None:
        return DiffuseTransfer(transfer=transfer, **drawn(geometry), version=VERSION, **metadata)
    albedo = torch.as_tensor(points.albedo)
    where = _where(points.positions, points.normals, albedo, torch.zeros(0, 3))
    return DiffuseTransfer(transfer=transfer, **where, version=VERSION, **metadata)


def drawn(geometry: Geometry) -> dict[str, Any]:
    """Positions, normals, albedo and faces of the receivers of a scene."""
    return _where(geometry.receiver_positions, geometry.receiver_normals, geometry.albedo, geometry.display_faces)


def uniform(weights: Tensor) -> Tensor:
    """One row if all rows are equal."""
    alike = len(weights) > 0 and bool((weights == weights[0]).all())
    return weights[:1].clone() if alike else weights


def _where(positions: Tensor, normals: Tensor, albedo: Tensor, faces: Tensor) -> dict[str, Any]:
    # A scan comes in float32: twice the bytes would say nothing more.
    single = positions.to(torch.float32)
    exact = bool((single.to(torch.float64) == positions).all())
    return {
        "positions": single if exact else positions,
        "normals": normals.to(torch.float32),
        "albedo": uniform(albedo),
        "faces": faces.to(torch.int32),
    }
