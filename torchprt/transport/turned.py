"""Receivers whose faces cancel or oppose each other, with normals that see."""

from __future__ import annotations

import dataclasses

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.transfer import Sight
from torchprt.transport.directions import frames
from torchprt.transport.receivers import Receivers
from torchprt.transport.sides import first_of_most, least_cosine, most, sides_of
from torchprt.transport.views import Viewer

# Rays a receiver: enough to suspect it, and to judge it.
GLANCE, LOOK = 16, 128
# Cosines of a normal with its faces below which it may be wrong; faces that a turned one must agree with.
CREASED = 0.5


def turned(viewer: Viewer, receivers: Receivers, sight: Tensor) -> tuple[Geometry, Receivers]:
    """Receivers whose normal is missing, or wrong for most of their faces, with one that sees."""
    geometry = viewer.geometry
    rows = _creased(viewer, receivers)
    sides = sides_of(geometry, rows)
    if not len(sides.row):
        # None, or only such whose faces have no area and say nothing.
        return geometry, receivers
    row = rows[sides.row]
    each = _looking(viewer, receivers, row, sides.normal, sides.inward)
    free = viewer.look(each, row, LOOK).free
    # Of sides that see alike the largest; the front of a sheet of two sides is where most of its area faces.
    size = sides.area / most(sides.row, sides.area, len(rows)).clamp(min=1e-300)[sides.row]
    score = torch.where(_single(geometry)[row], free + 1e-4 * size, size)
    best = first_of_most(sides.row, score, len(rows))
    agree = ((sides.normal * sides.normal[best.clamp(min=0)][sides.row]).sum(-1) > CREASED).double()[:, None]
    none = torch.zeros(len(rows), 3, dtype=torch.float64)
    normals = none.index_add(0, sides.row, agree * size[:, None] * sides.normal)
    # Slivers have a direction too, as small as they are.
    normals = torch.nn.functional.normalize(normals, dim=-1, eps=1e-300)
    count = none[:, :1].index_add(0, sides.row, agree).clamp(min=1)
    inward = none.index_add(0, sides.row, agree * sides.inward) / count
    turned = _looking(viewer, receivers, rows, normals, inward)
    after = viewer.look(turned, rows, LOOK).free
    before = viewer.views(receivers, rows, LOOK).free
    missing = (receivers.normals[rows] == 0).all(-1)
    better = (best >= 0) & (normals != 0).any(-1) & (missing | (after >= 2 * before.clamp(min=1 / LOOK)))
    rows, turned, inward = rows[better], turned[better], inward[better]
    # The other side of a sheet looks the other way.
    front, back = geometry.receiver_of_vertex, geometry.back_receiver_of_vertex
    both = (front >= 0) & (back >= 0)
    other = torch.full((geometry.receivers,), -1)
    other[front[both]] = back[both]
    sheets = other[rows] >= 0
    behind = other[rows[sheets]]
    reverse = _looking(viewer, receivers, behind, -turned.normals[sheets], inward[sheets])
    rows = torch.cat([rows, behind])
    normals, origins = receivers.normals.clone(), receivers.origins.clone()
    normals[rows] = torch.cat([turned.normals, reverse.normals])
    origins[rows] = torch.cat([turned.origins, reverse.origins])
    sight[rows] = int(Sight.TURNED)
    tangents = geometry.tangents.clone()
    changed = torch.isin(geometry.glossy, rows)
    tangents[changed] = frames(normals[geometry.glossy[changed]])[:, 0]
    geometry = dataclasses.replace(geometry, receiver_normals=normals, tangents=tangents)
    return geometry, dataclasses.replace(receivers, normals=normals, origins=origins)


def _single(geometry: Geometry) -> Bool[Tensor, "V"]:
    """Which receivers are of a surface of one side."""
    both = (geometry.receiver_of_vertex >= 0) & (geometry.back_receiver_of_vertex >= 0)
    single = torch.ones(geometry.receivers, dtype=torch.bool)
    single[geometry.receiver_of_vertex[both]] = False
    single[geometry.back_receiver_of_vertex[both]] = False
    return single


def _creased(viewer: Viewer, receivers: Receivers) -> Int[Tensor, "v"]:
    """Receivers without normal, and those of one side whose normal opposes a face and that see less than half."""
    geometry = viewer.geometry
    missing = viewer.used & (receivers.normals == 0).all(-1) & ~viewer.reverse
    oppose = least_cosine(geometry, receivers) < CREASED
    rows = torch.nonzero(oppose & _single(geometry) & (receivers.normals != 0).any(-1))[:, 0]
    rows = rows[viewer.views(receivers, rows, GLANCE).free < 0.5]
    return torch.cat([torch.nonzero(missing)[:, 0], rows])


def _looking(viewer: Viewer, receivers: Receivers, rows: Tensor, normals: Tensor, inward: Tensor) -> Receivers:
    """`rows` of the receivers with other normals, and origins as `vertex_receivers` has them."""
    points = receivers.points[rows]
    away = inward - (inward * normals).sum(-1, keepdim=True) * normals + normals
    return Receivers(points, normals, viewer.tracer.origins(points, away, viewer.size[rows]))
