"""What a point of a body gets of the light that enters a face near it: the dipole over a triangle, without samples."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from torchprt.brdf import Dipole
from torchprt.scene.weld import weld

_TINY = torch.finfo(torch.float64).tiny
# Where a face is integrated along its sides, in its sizes; elsewhere at 7 points.
_LINES, _NODES = 1.2, 6
_PAIRS = 2048
"""Pairs at a time: what they need stays in a core's cache."""
# A rule of degree 5 on a triangle: barycentrics of a point of each three, and weights. Source: Radon 1948.
_ROOT = 15**0.5
_RULE = [
    (1 / 3, 1 / 3, 9 / 40),
    *(
        (near, far, weight)
        for one, two, weight in (
            ((9 - 2 * _ROOT) / 21, (6 + _ROOT) / 21, (155 + _ROOT) / 1200),
            ((9 + 2 * _ROOT) / 21, (6 - _ROOT) / 21, (155 - _ROOT) / 1200),
        )
        for near, far in ((one, two), (two, one), (two, two))
    ),
]


def turn_share(positions: Float64[Tensor, "v 3"], faces: Int64[Tensor, "f 3"]) -> Float64[Tensor, "v"]:
    """A full turn over the angles of the faces around each vertex, copies of it at a seam included."""
    place = torch.from_numpy(weld(positions.numpy()))
    corners = positions[faces]
    total = torch.zeros(len(positions), dtype=torch.float64)
    for corner in range(3):
        one, other = (corners[:, (corner + step) % 3] - corners[:, corner] for step in (1, 2))
        angle = torch.atan2(torch.linalg.cross(one, other).norm(dim=-1), (one * other).sum(-1))
        total.index_add_(0, place[faces[:, corner]], angle)
    return torch.where(total > 0, 2 * torch.pi / total.clamp(min=1e-6), 1.0)[place]


def near_faces(
    positions: Float64[Tensor, "v 3"],
    faces: Int64[Tensor, "f 3"],
    vertex: Int64[Tensor, "P"],
    face: Int64[Tensor, "P"],
    source: Dipole,
    turn: Float64[Tensor, "v"],
) -> tuple[Int64[Tensor, "E"], Int64[Tensor, "E"], Float64[Tensor, "C E"]]:
    """What vertices get of the light that enters faces near them, as entries of a matrix: its row (who gets), column
    (at which vertex the light is) and values. Entries of one place follow each other as they come.

    A vertex's own faces count as if they made the full `turn` of a smooth surface: how little of the surface is about a
    sharp corner is told by the faces further off, and below the size of a face nothing else is known.
    """
    found = torch.empty(len(source.real), 3, len(face), dtype=torch.float64)
    corners = positions[faces]
    apart = (positions[vertex] - corners.mean(1)[face]).norm(dim=-1)
    size = torch.stack([corners[:, k] - corners[:, k - 1] for k in range(3)]).norm(dim=-1).amax(0)
    by_lines = apart**2 + float(source.real.min()) ** 2 < (_LINES * size[face]) ** 2
    for which, make in ((by_lines, _by_lines), (~by_lines, _by_points)):
        for some in torch.nonzero(which)[:, 0].split(_PAIRS):
            here, there = positions[vertex[some]].T.contiguous(), corners[face[some]].permute(1, 2, 0).contiguous()
            found[:, :, some] = make(here, there, source)
    # Copies at a seam are one place.
    own = (positions[faces[face]] == positions[vertex][:, None]).all(-1).any(-1)
    found *= torch.where(own, turn[vertex], 1.0)
    return vertex.repeat(3), faces[face].T.flatten(), found.flatten(1)


def _by_lines(points: Tensor, corners: Tensor, source: Dipole) -> Tensor:
    return over_faces(points, corners, source, _NODES)


def _by_points(points: Tensor, corners: Tensor, source: Dipole) -> Float64[Tensor, "C 3 P"]:
    """The same as `over_faces` where the profile changes little over a face."""
    area = torch.linalg.cross(corners[1] - corners[0], corners[2] - corners[0], dim=0).norm(dim=0) / 2
    found = torch.zeros(len(source.real), 3, points.shape[1], dtype=torch.float64)
    for one, two, weight in _RULE:
        share = torch.tensor([one, two, 1 - one - two], dtype=torch.float64)
        square = ((points - torch.einsum("k,kip->ip", share, corners)) ** 2).sum(0)
        value = source.at_square(square).T * area
        for corner in range(3):
            found[:, corner].add_(value, alpha=weight * float(share[corner]))
    return found


@lru_cache(maxsize=4)
def _gauss(count: int) -> tuple[list[float], list[float]]:
    nodes, weights = np.polynomial.legendre.leggauss(count)
    return nodes.tolist(), weights.tolist()


def over_faces(
    points: Float64[Tensor, "3 P"], corners: Float64[Tensor, "3 3 P"], source: Dipole, nodes: int
) -> Float64[Tensor, "C 3 P"]:
    """The integral of the dipole's profile times the hat function of each corner over a triangle, for P pairs of a
    point and a triangle (`corners`: corner, then x, y, z).

    Both integrals, of the profile and of its first moments, become line integrals along the sides: with x0 the point's
    foot in the plane, r = |y - x0| and F the antiderivative of R_d(r) r, which has a closed form (see
    `Dipole.within`), they are the integral of (F(r) - F(0)) / r^2 (y - x0).m and of F m, m the outward normal of a side
    in the plane. So a body's irradiance, linear over its faces, is met however far the mean free path is below the
    size of a face; what errs are the `nodes` of Gauss and Legendre along each side. Faces without area give 0.
    """
    one, two = corners[1] - corners[0], corners[2] - corners[0]
    normal = torch.linalg.cross(one, two, dim=0)
    twice = normal.norm(dim=0)
    flat = twice <= 0
    normal = normal / twice.clamp(min=_TINY)
    height = ((points - corners[0]) * normal).sum(0)
    from_foot = corners - (points - height * normal)
    # A side runs from its corner to the next.
    along = corners.roll(-1, 0) - corners
    length = along.norm(dim=1)
    along = along / length.clamp(min=_TINY)[:, None]
    outward = torch.linalg.cross(along, normal.expand_as(along), dim=1)
    start, reach = (from_foot * along).sum(1), (from_foot * outward).sum(1)
    whole, first = _lines(start, length, reach, height**2, source, nodes)
    # The hat function of a corner falls along the normal of the side opposite to it.
    opposite = [1, 2, 0]
    slope = (length / twice.clamp(min=_TINY))[opposite]
    # [C, e, P] along outward [e, 3, P]: the first moments [C, 3, P].
    moments = (first[:, :, None] * outward).sum(1)
    found = slope * (reach[opposite] * whole[:, None] - (moments[:, None] * outward[opposite]).sum(2))
    return torch.where(flat, 0.0, found)


def _lines(
    start: Tensor, length: Tensor, reach: Tensor, height: Tensor, source: Dipole, nodes: int
) -> tuple[Float64[Tensor, "C P"], Float64[Tensor, "C 3 P"]]:
    """Integrals along the sides: of (F - F(0)) / r^2 times `reach`, summed over them, and of F. `height` is squared."""
    # Nodes where the integrand changes: it is as wide as the distance of the side from the sources.
    width = torch.sqrt(reach**2 + height + float(source.real.min()) ** 2)
    low, high = torch.asinh(start / width), torch.asinh((start + length) / width)
    middle, half = (low + high) / 2, (high - low) / 2
    colours = len(source.real)
    whole = torch.zeros(colours, *reach.shape, dtype=torch.float64)
    first = torch.zeros_like(whole)
    for node, weight in zip(*_gauss(nodes), strict=True):
        at = torch.exp(middle + half * node)
        square = reach**2 + (width * (at - 1 / at) / 2) ** 2
        step = width * half * (at + 1 / at) * (weight / 2)
        for colour in range(colours):
            decay = float(source.decay[colour])
            for depth in (float(source.real[colour]), float(source.virtual[colour])):
                nearest = height + depth**2
                # A difference of two numbers that agree: at this distance they still differ by 1e-8 of themselves.
                apart = torch.maximum(square, 1e-8 * nearest)
                nearest = nearest.sqrt()
                far = torch.sqrt(apart + nearest**2)
                there, at_foot = torch.exp(far * -decay).div_(far), torch.exp(nearest * -decay).div_(nearest)
                whole[colour].addcmul_((at_foot - there).div_(apart), step, value=depth)
                first[colour].addcmul_(there, step, value=-depth)
    scale = source.albedo / (4 * torch.pi)
    return scale[:, None] * (whole * reach).sum(1), scale[:, None, None] * first
