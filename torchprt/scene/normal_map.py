"""Normals of a picture in the tangent space of its texture coordinates, as glTF has it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor
from torch.nn.functional import normalize

from .tangents import tangents_from_uv

# A normal of a picture that points into the surface is taken as one that rises this little, beside its length.
LEAST = 1e-3


class TangentSpace(NamedTuple):
    """Of each corner of F faces the direction of increasing u, unit or zero where there is none, and of each face 1 or
    -1: the bitangent, up the picture, is that times normal x tangent."""

    tangents: Float[np.ndarray, "F 3 3"]
    handed: Float[np.ndarray, "F"]


def tangent_space(
    positions: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "V 3"],
    uv: Float[np.ndarray, "F 3 2"],
    tangents: Float[np.ndarray, "V 3"] | None = None,
    handed: Float[np.ndarray, "V"] | None = None,
) -> TangentSpace:
    """The tangent space of faces whose corners are at `uv` of a picture, v down.

    `tangents` with `handed` (1 or -1, 0 for none) are those of the file: faces all of whose corners have them take
    them. The others take the mean over the faces around a corner, by angle, of the direction of increasing u, of those
    faces alone that are not mirrored against each other and have the same u and v there.
    Source: the specification of glTF 2.0, sections 3.7.2.1 and 3.9.3; Mikkelsen 2008, "Simulation of wrinkled surfaces
    revisited", section 2, which averages alike.
    """
    sides = uv[:, 1:] - uv[:, :1]
    area = sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]
    with np.errstate(invalid="ignore"):
        # Seen with v up, faces that run counter-clockwise have the bitangent normal x tangent.
        turn = -np.sign(np.nan_to_num(area))
    corners = positions[faces]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Normals may point the other way than faces are wound.
    turn *= np.where((facing * normals[faces].sum(1)).sum(1) < 0, -1.0, 1.0)
    rows = np.column_stack([faces.reshape(-1, 1), uv.reshape(-1, 2), np.repeat(turn, 3)])
    _, first, group = np.unique(np.nan_to_num(rows, nan=-1e30), axis=0, return_index=True, return_inverse=True)
    vertex = faces.ravel()[first]
    along = tangents_from_uv(positions[vertex], group.reshape(-1, 3), normals[vertex], uv)[group.reshape(-1, 3)]
    if tangents is not None and handed is not None:
        told = ((handed[faces] != 0) & (tangents[faces] != 0).any(-1)).all(1)
        along = np.where(told[:, None, None], tangents[faces], along)
        turn = np.where(told, np.sign(handed[faces].sum(1)), turn)
    return TangentSpace(along, turn)


def mapped_normals(
    normals: Float64[Tensor, "E 3"],
    tangents: Float64[Tensor, "E 3"],
    handed: Float64[Tensor, "E"],
    colours: Float[Tensor, "E 3"],
    scale: float = 1.0,
) -> Float64[Tensor, "E 3"]:
    """Unit normals of a picture: n = x T + y B + z N, where `colours` are (x, y, z) / 2 + 1/2 and B = `handed` N x T.

    x and y are multiplied by `scale`. T is made orthogonal to N; where it is zero, N stays. A normal that points into
    the surface is brought out of it.
    Source: the specification of glTF 2.0, section 3.9.3.
    """
    along = tangents - (tangents * normals).sum(-1, keepdim=True) * normals
    size = along.norm(dim=-1, keepdim=True)
    along = along / size.clamp(min=1e-12)
    up = handed[:, None] * torch.linalg.cross(normals, along)
    x, y, z = (2 * colours.double() - 1).unbind(-1)
    x, y = x * scale, y * scale
    z = torch.maximum(z, LEAST * (x * x + y * y).sqrt().clamp(min=LEAST))
    found = x[:, None] * along + y[:, None] * up + z[:, None] * normals
    return torch.where(size > 1e-6, normalize(found, dim=-1), normals)
