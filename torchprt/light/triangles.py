"""Triangles seen from points: their light by quadrature, how far they are, and the angle that they take."""

from __future__ import annotations

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh import basis
from torchprt.sh.constant import remembered

# Nodes along each side of a piece, of one that is near and of one that is small where it is seen.
NEAR, FAR = 6, 3
# A piece is at most this part of its distance, and at most so many radians over the order of the light.
PART, RADIANS, SMALL = 0.5, 2.5, 0.125
MOST = 128
PIECE = 1 << 22


def triangle_lights(
    points: Float[Tensor, "S 3"],
    corners: Float[Tensor, "F 3 3"],
    radiance: Float[Tensor, "F 3"],
    order: int,
    both: bool,
) -> Float[Tensor, "S N 3"]:
    """The light at points of triangles that shine to the side that they face, or to `both`.

    Pairs of a point and a triangle that need as many pieces are worked on together. Differentiable in all.
    Raises InputError if a triangle is nearer to a point than 1/64 of its longest side.
    """
    first, second, third = corners.unbind(1)
    sides = corners.detach() - corners.detach().roll(1, 1)
    ratio = sides.double().norm(dim=-1).amax(1) / closest(points.detach().double(), corners.detach().double())
    pieces = ratio * max(1 / PART, order / RADIANS)
    levels = torch.where(ratio * max(1, order / 5) <= SMALL, -1, pieces.clamp(min=1).log2().ceil()).long()
    if bool((levels > math.log2(MOST)).any()):
        raise InputError(
            "a triangle of a lamp is very close to a sample point for its size: move it away, or make it of smaller "
            "ones"
        )
    across = torch.linalg.cross(second - first, third - first)
    total = points.new_zeros(len(points), order * order, 3)
    for level in levels.unique().tolist():
        nodes, weights = (table.to(points) for table in _rule(points.device, level, points.dtype))
        at, of = torch.nonzero(levels == level, as_tuple=True)
        step = max(1, PIECE // (len(nodes) * order * order))
        for point, face in zip(at.split(step), of.split(step), strict=True):
            places = (nodes[:, :, None] * corners[face][:, None]).sum(2)
            steps = places - points[point][:, None]
            squared = steps.square().sum(-1)
            directions = steps * squared.rsqrt()[..., None]
            # Twice the area times the cosine at the lamp.
            facing = -(directions * across[face][:, None]).sum(-1)
            seen = (facing.abs() if both else facing.clamp(min=0)) * weights / squared
            coefficients = (basis(directions, order) * seen[..., None]).sum(1)
            total = total.index_add(0, point, coefficients[..., None] * radiance[face][:, None])
    return total


@remembered(32)
def _rule(level: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Barycentric nodes `[Q, 3]` and weights, which sum to a half, of a triangle in 4^level equal pieces."""
    count = FAR if level < 0 else NEAR
    ticks, gauss = (torch.from_numpy(each) for each in np.polynomial.legendre.leggauss(count))
    ticks, gauss = (ticks + 1) / 2, gauss / 2
    # The square collapsed into the triangle.
    u, v = torch.meshgrid(ticks, ticks, indexing="ij")
    a, b = u.flatten(), (v * (1 - u)).flatten()
    weights = (gauss[:, None] * gauss * (1 - u)).flatten()
    parts = 2 ** max(level, 0)
    row, column = (each.flatten() for each in torch.meshgrid(torch.arange(parts), torch.arange(parts), indexing="ij"))
    upright, hanging = row + column < parts, row + column < parts - 1
    x = torch.cat([a + row[upright, None], 1 - a + row[hanging, None]]).flatten() / parts
    y = torch.cat([b + column[upright, None], 1 - b + column[hanging, None]]).flatten() / parts
    nodes = torch.stack([1 - x - y, x, y], -1)
    return nodes.to(dtype), (weights / parts**2).repeat(parts**2).to(dtype)


def closest(points: Float[Tensor, "S 3"], corners: Float[Tensor, "F 3 3"]) -> Float[Tensor, "S F"]:
    """Distances from points to triangles, a block of points at a time."""
    step = max(1, PIECE // (9 * max(len(corners), 1)))
    return (
        torch.cat([_closest(block, corners) for block in points.split(step)])
        if len(points)
        else points.new_zeros(0, len(corners))
    )


def _closest(points: Tensor, corners: Tensor) -> Tensor:
    """To the face where a point stands above it, else to the nearest of its sides."""
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = normal.norm(dim=-1)
    unit = normal / doubled.clamp(min=torch.finfo(normal.dtype).tiny)[:, None]
    height = ((points[:, None] - corners[None, :, 0]) * unit).sum(-1)
    above = torch.ones_like(height, dtype=torch.bool) & (doubled > 0)
    nearest = torch.full_like(height, math.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        begin, along = corners[:, first], corners[:, second] - corners[:, first]
        steps = points[:, None] - begin
        above &= (torch.linalg.cross(along.expand_as(steps), steps) * unit).sum(-1) >= 0
        length = along.square().sum(-1).clamp(min=torch.finfo(along.dtype).tiny)
        share = ((steps * along).sum(-1) / length).clamp(0, 1)
        nearest = torch.minimum(nearest, (steps - share[..., None] * along).norm(dim=-1))
    return torch.where(above, height.abs(), nearest)


def solid_angles(points: Float[Tensor, "S 3"], corners: Float[Tensor, "F 3 3"]) -> Float[Tensor, "S F"]:
    """The solid angle that each triangle takes at points, above zero where its back is seen.

    Source: van Oosterom and Strackee 1983, "The solid angle of a plane triangle".
    """
    step = max(1, PIECE // (9 * max(len(corners), 1)))
    return (
        torch.cat([_angles(block, corners) for block in points.split(step)])
        if len(points)
        else points.new_zeros(0, len(corners))
    )


def _angles(points: Tensor, corners: Tensor) -> Tensor:
    a, b, c = (corners[None, :, number] - points[:, None] for number in range(3))
    one, two, three = (side.norm(dim=-1) for side in (a, b, c))
    volume = (a * torch.linalg.cross(b, c)).sum(-1)
    rest = one * two * three + (a * b).sum(-1) * three + (b * c).sum(-1) * one + (c * a).sum(-1) * two
    return 2 * torch.atan2(volume, rest)
