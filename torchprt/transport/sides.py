"""The faces that meet at receivers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.scene.normals import face_normals
from torchprt.transport.receivers import Receivers


@dataclass
class Sides:
    """The faces that meet at some receivers, one after the other: of which `row` (a number among those receivers), and
    each with its `normal`, `area` and the direction `inward` from the receiver to its middle."""

    row: Int[Tensor, "s"]
    normal: Float[Tensor, "s 3"]
    area: Float[Tensor, "s"]
    inward: Float[Tensor, "s 3"]


def sides_of(geometry: Geometry, rows: Int[Tensor, "v"]) -> Sides:
    """The faces with area that meet at `rows` of the receivers."""
    number = torch.full((geometry.receivers,), -1)
    number[rows] = torch.arange(len(rows))
    faces = geometry.display_faces[(number[geometry.display_faces] >= 0).any(-1)]
    positions = geometry.receiver_positions
    normal = torch.from_numpy(face_normals(positions.numpy(), faces.numpy()))
    corners = positions[faces]
    area = torch.linalg.vector_norm(
        torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), dim=-1
    )
    inward = torch.nn.functional.normalize(corners.mean(1, keepdim=True) - corners, dim=-1, eps=1e-300)
    face, corner = torch.nonzero((number[faces] >= 0) & (normal != 0).any(-1, keepdim=True), as_tuple=True)
    return Sides(number[faces[face, corner]], normal[face], area[face], inward[face, corner])


def least_cosine(geometry: Geometry, receivers: Receivers) -> Float[Tensor, "V"]:
    """The least cosine between the normal of each receiver and those of its faces; 1 without faces."""
    faces = geometry.display_faces
    normal = torch.from_numpy(face_normals(geometry.receiver_positions.numpy(), faces.numpy()))
    least = torch.ones(geometry.receivers, dtype=torch.float64)
    for corner in faces.unbind(-1):
        cosine = (normal * receivers.normals[corner]).sum(-1)
        cosine = torch.where((normal != 0).any(-1), cosine, 1.0)
        least = least.scatter_reduce(0, corner, cosine, "amin")
    return least


def most(row: Tensor, values: Tensor, count: int) -> Float[Tensor, "v"]:
    return values.new_full((count,), -np.inf).scatter_reduce(0, row, values, "amax")


def first_of_most(row: Tensor, values: Tensor, count: int) -> Int[Tensor, "v"]:
    """The first entry of each row that holds its largest value; -1 for a row without entries."""
    winners = torch.nonzero(values == most(row, values, count)[row])[:, 0]
    best = torch.full((count,), len(values))
    best = best.scatter_reduce(0, row[winners], winners, "amin")
    return torch.where(best < len(values), best, -1)
