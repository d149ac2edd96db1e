"""Receivers that cannot see for themselves: found, and turned, moved or marked to be filled."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.trace import Tracer
from torchprt.transfer import Sight
from torchprt.transport.receivers import Receivers
from torchprt.transport.sides import Sides, first_of_most, least_cosine, sides_of
from torchprt.transport.task import Runner
from torchprt.transport.turned import GLANCE, LOOK, turned
from torchprt.transport.validity import Validity, filling
from torchprt.transport.views import LOST, Viewer, Views

# A receiver that sees less than this part of the median of its neighbours is lost if anything else speaks for it:
# this share of odd rays, or of near ones, or a face whose back it looks at. The corner of a room has a half.
DARKER, ODD, NEAR = 0.45, 0.02, 0.5
# Receivers that see nothing and hang together, up to which they are a speck and not the floor of a cave.
SPECK = 32
# Steps off the surface tried for origins in front of all faces, in those of any other receiver.
STEPS = (1.0, 8.0, 64.0)


def with_sight(
    geometry: Geometry, tracer: Tracer, receivers: Receivers, runner: Runner
) -> tuple[Geometry, Receivers, Validity]:
    """The scene and its receivers with normals and origins that see, and which are to be filled from others.

    A receiver is *turned* if its faces cancel to a zero normal, or oppose each other so that it sees less than half of
    the hemisphere and the mean of those of its faces that see most sees twice as much. It cannot see
    - if a quarter of its rays end nearby on the back of its own piece of surface, or of a closed one (a fold);
    - if nearly all end within rounding of where they start (a flap that lies on it);
    - if none escapes and half of them meet backs (it is buried in another solid);
    - if no ray escapes, nor from those around it, but these are few (a crack, two layers of a scan);
    - if it sees much less than its neighbours, and either some rays end on backs nearby, or half of them where they
      start, or it looks at the back of one of its faces (a pit, a fold that hangs over it).
    It is then *moved* along the direction that is in front of all of its faces, if it sees from there; else it is to
    be *filled*. In a closed surface of consistent winding that does not cut itself and has no pits, nothing is touched.

    Source: Rays on back faces as a sign are what lightmap bakers call validity.
    """
    viewer = Viewer(geometry, tracer, runner)
    sight = torch.zeros(len(receivers), dtype=torch.uint8)
    geometry, receivers = turned(viewer, receivers, sight)
    alive = torch.nonzero((receivers.normals != 0).any(-1))[:, 0]
    glance = viewer.views(receivers, alive, GLANCE)
    folded = least_cosine(geometry, receivers)[alive] < 0
    chosen = (glance.odd > 0) | (glance.near >= NEAR / 2) | (glance.free == 0) | folded
    suspects, folded = alive[chosen], folded[chosen]
    views = viewer.views(receivers, suspects, LOOK)
    doubtful = (views.odd >= ODD) | (views.near >= NEAR) | folded
    wrong = views.blind | _darker(viewer, receivers, suspects, views, doubtful & ~views.blind)
    wrong |= _specks(geometry, suspects, (views.free == 0) & ~wrong)
    rows = suspects[wrong]
    moved, origins = _moved(viewer, receivers, rows, views.free[wrong])
    sight[rows] = int(Sight.FILLED)
    sight[rows[moved]] = int(Sight.MOVED)
    replaced = receivers.origins.clone()
    replaced[rows[moved]] = origins[moved]
    receivers = dataclasses.replace(receivers, origins=replaced)
    # Faces without area leave no normal to turn to.
    sight[viewer.used & (receivers.normals == 0).all(-1)] = int(Sight.FILLED)
    return geometry, receivers, filling(geometry, receivers.normals, sight)


def _darker(
    viewer: Viewer, receivers: Receivers, rows: Tensor, views: Views, doubtful: Bool[Tensor, "v"]
) -> Bool[Tensor, "v"]:
    """Whether doubtful receivers see much less than the median of what their neighbours see."""
    result = torch.zeros(len(rows), dtype=torch.bool)
    chosen = rows[doubtful]
    if not len(chosen):
        return result
    ring = _ring(viewer.geometry, chosen)
    around, number = ring[:, 1].unique(return_inverse=True)
    free = viewer.views(receivers, around, LOOK).free
    known = torch.zeros(len(receivers), dtype=torch.float64)
    known[rows] = views.free
    result[doubtful] = known[chosen] < DARKER * _medians(ring[:, 0], free[number], chosen)
    return result


def _specks(geometry: Geometry, rows: Tensor, dark: Bool[Tensor, "v"]) -> Bool[Tensor, "v"]:
    """Which of the `dark` rows hang together with few others of them."""
    result = torch.zeros(len(rows), dtype=torch.bool)
    chosen = rows[dark]
    number = torch.full((geometry.receivers,), -1)
    number[chosen] = torch.arange(len(chosen))
    pairs = number[_ring(geometry, chosen)]
    one, other = pairs[(pairs >= 0).all(-1)].numpy().T
    graph = coo_matrix((np.ones(len(one), bool), (one, other)), (len(chosen), len(chosen)))
    _, piece = connected_components(graph, directed=False)
    result[dark] = torch.from_numpy(np.bincount(piece, minlength=1)[piece] <= SPECK)
    return result


def _medians(row: Tensor, values: Tensor, chosen: Tensor) -> Float[Tensor, "v"]:
    """The (lower) median of the values of each of the `chosen`, ascending rows."""
    order = values.argsort()
    order = order[row[order].argsort(stable=True)]
    count = torch.searchsorted(row[order], chosen, right=True) - (first := torch.searchsorted(row[order], chosen))
    return values[order[first + (count - 1) // 2]]


def _ring(geometry: Geometry, rows: Int[Tensor, "v"]) -> Int[Tensor, "e 2"]:
    """Pairs of one of `rows` and a receiver that shares a face with it."""
    wanted = torch.zeros(geometry.receivers, dtype=torch.bool)
    wanted[rows] = True
    faces = geometry.display_faces
    faces = faces[wanted[faces].any(-1)]
    pairs = torch.cat([faces[:, [i, j]] for i in range(3) for j in range(3) if i != j])
    return pairs[wanted[pairs[:, 0]]].unique(dim=0)


def _moved(
    viewer: Viewer, receivers: Receivers, rows: Int[Tensor, "v"], free: Float[Tensor, "v"]
) -> tuple[Bool[Tensor, "v"], Float[Tensor, "v 3"]]:
    """Origins in front of all faces of `rows`, and which of them see from there."""
    sides = sides_of(viewer.geometry, rows)
    direction = _in_front(sides, receivers.normals[rows])
    origins, found = receivers.origins[rows].clone(), torch.zeros(len(rows), dtype=torch.bool)
    for step in STEPS:
        tried = receivers[rows]
        tried.origins = viewer.tracer.origins(tried.points, step * direction, viewer.size[rows])
        views = viewer.look(tried, rows, LOOK)
        better = ~found & ~views.blind & (views.free >= (2 * free).clamp(min=LOST))
        origins[better] = tried.origins[better]
        found |= better
    return found, origins


def _in_front(sides: Sides, first: Float[Tensor, "v 3"]) -> Float[Tensor, "v 3"]:
    """For each receiver the direction whose least height over its faces is greatest (projected subgradient steps)."""
    direction = first.clone()
    if not len(sides.row):
        return direction
    for step in range(256):
        height = (sides.normal * direction[sides.row]).sum(-1)
        lowest = first_of_most(sides.row, -height, len(first))
        push = torch.where((lowest >= 0)[:, None], sides.normal[lowest.clamp(min=0)], 0.0)
        direction = torch.nn.functional.normalize(direction + push / (2 + step), dim=-1)
    return direction
