"""Tangent frames of a surface from its texture coordinates, in any pose."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.errors import InputError


def surface_frames(
    positions: Float[Tensor, "*B V 3"],
    faces: Int[Tensor, "F 3"],
    uv: Float[Tensor, "..."] | None,
    normals: Float[Tensor, "*#B V 3"] | None = None,
) -> Float[Tensor, "*B V 3 3"]:
    """Tangent frames of a surface in any pose: `world = frame @ local`, columns tangent, bitangent, normal.

    The normal is that of the faces around a vertex, weighted by area, or the given one; the tangent is the direction
    of increasing u, orthogonal to it; the bitangent is the remaining one, on the side of increasing v: where texture
    coordinates are mirrored the frame is left-handed, and lobes are mirrored with it. Where they say no direction any
    tangent is taken; a vertex without faces has zero columns. `uv` as `lay` takes it. Gradients flow to the positions.

    Laws: turning the positions turns the frames; neither scale of the surface nor of the coordinates matters.
    Raises InputError if there are no texture coordinates, some are missing, or shapes do not fit.
    """
    corners = corner_uv(faces, uv, positions.shape[-2])
    corners = torch.where(torch.isfinite(corners), corners, 0).to(positions)
    points = positions[..., faces.flatten(), :].unflatten(-2, (-1, 3))
    # Areas of a surface of size 1e-30 would be too small for a number, of 1e30 too large.
    edges = (points[..., 1:, :] - points[..., :1, :]) if faces.numel() else points.new_ones(1)
    points = points / edges.detach().abs().amax().clamp(min=torch.finfo(points.dtype).tiny)
    e, f = (points[..., corner, :] - points[..., 0, :] for corner in (1, 2))
    d, g = (corners[:, corner] - corners[:, 0] for corner in (1, 2))
    turn = d[:, 0] * g[:, 1] - d[:, 1] * g[:, 0]
    # The direction of increasing u in a face; mirrored coordinates have a negative area.
    along = normalize((g[:, 1:] * e - d[:, 1:] * f) * turn.sign()[:, None], dim=-1)
    area = torch.linalg.cross(e, f, dim=-1)
    size = torch.linalg.vector_norm(area, dim=-1, keepdim=True)
    summed = torch.cat([area, along * size, turn.sign()[:, None] * size], -1)
    total = summed.new_zeros(*positions.shape[:-1], 7)
    for corner in faces.long().unbind(-1):
        total = total.index_add(-2, corner, summed)
    normal = normalize(total[..., :3] if normals is None else normals.to(total).expand_as(positions), dim=-1)
    tangent = total[..., 3:6] - (total[..., 3:6] * normal).sum(-1, keepdim=True) * normal
    # Rounding leaves a direction where there is none.
    weak = torch.linalg.vector_norm(tangent.detach(), dim=-1) <= 1e-4 * torch.linalg.vector_norm(
        total[..., :3].detach(), dim=-1
    )
    tangent = normalize(torch.where(weak[..., None], _any_tangent(normal), tangent), dim=-1)
    hand = torch.where(total[..., 6:] < 0, -1.0, 1.0)
    return torch.stack([tangent, hand * torch.linalg.cross(normal, tangent, dim=-1), normal], -1)


def vertex_uv(faces: Int[Tensor, "F 3"], uv: Float[Tensor, "..."] | None, vertices: int) -> Float[Tensor, "V 2"]:
    """A pair of texture coordinates for each vertex: that of its first corner; 0 for a vertex without faces.

    Raises InputError if there are none, some are missing, or shapes do not fit.
    """
    if uv is not None and uv.shape == (vertices, 2) and not len(faces):
        return uv
    corners = corner_uv(faces, uv, vertices)
    first = first_corner(faces, vertices)
    missing = ~torch.isfinite(corners).all(-1).flatten()
    if bool(missing.any()):
        raise InputError(
            f"surface has {int(missing.sum())} corners of faces without texture coordinates: unwrap all of it"
        )
    pairs = torch.cat([corners.reshape(-1, 2), corners.new_zeros(1, 2)])
    return pairs[first]


def corner_uv(faces: Int[Tensor, "F 3"], uv: Float[Tensor, "..."] | None, vertices: int) -> Float[Tensor, "F 3 2"]:
    """Texture coordinates of the corners of faces. InputError without them, or if they do not fit."""
    if uv is None:
        raise InputError("surface has no texture coordinates: unwrap it (a patch is laid on through them)")
    if uv.shape == (len(faces), 3, 2):
        return uv
    if uv.shape != (vertices, 2):
        raise InputError(
            f"uv have shape {list(uv.shape)} for {vertices} vertices and {len(faces)} faces: give [V, 2] or [F, 3, 2]"
        )
    return uv[faces.long()]


def first_corner(faces: Tensor, vertices: int) -> Int[Tensor, "V"]:
    """The number of the first corner at each vertex; one past the last where there is none."""
    corner = torch.arange(faces.numel(), device=faces.device)
    none = torch.full((vertices,), faces.numel(), device=faces.device)
    return none.scatter_reduce(0, faces.long().flatten(), corner, "amin")


def _any_tangent(normal: Float[Tensor, "*B 3"]) -> Float[Tensor, "*B 3"]:
    """A vector across each normal: from the coordinate axis that it has least of."""
    least = torch.nn.functional.one_hot(normal.detach().abs().argmin(-1), 3).to(normal)
    least = least * (normal.detach().abs().amax(-1, keepdim=True) > 0)
    return least - (least * normal).sum(-1, keepdim=True) * normal
