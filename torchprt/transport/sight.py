"""Receivers that cannot see for themselves: found, and turned, moved or marked to be filled."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.scene.normals import face_normals
from torchprt.scene.weld import edges, weld
from torchprt.trace import Tracer
from torchprt.transfer import Sight
from torchprt.transport.directions import frames, hemisphere
from torchprt.transport.receivers import Receivers
from torchprt.transport.solve import around_receivers
from torchprt.transport.validity import Validity, filling

# Rays a receiver: enough to suspect it, and to judge it.
GLANCE, LOOK = 16, 128
# The share of rays that meet what no ray from an outer side can meet, from which on a receiver is lost.
LOST = 0.25
# A receiver that sees less than this part of the median of its neighbours is lost if anything else speaks for it:
# this share of odd rays, or of near ones, or a face whose back it looks at. The corner of a room has a half.
DARKER, ODD, NEAR = 0.45, 0.02, 0.5
# If no ray escapes at all: the share of rays that meet the back of any face.
BURIED = 0.5
# The share of rays within rounding of where they start: where two walls stand on a floor it is three quarters.
COVERED = 0.85
# Cosines of a normal with its faces below which it may be wrong; faces that a turned one must agree with.
CREASED = 0.5
# Steps off the surface tried for origins in front of all faces, in those of any other receiver.
STEPS = (1.0, 8.0, 64.0)
# In place of the number of a piece of surface: those that enclose something hide any receiver.
_ANY = -2


@dataclass
class _Views:
    """Of some receivers the share of rays that escape, `free [v]`; of those that end nearby on the back of their own
    piece of surface or of a closed one, `lost`, or of any, `odd`; on the back of any face wherever, `back`; and within
    rounding of where they start, `near`."""

    free: Float[Tensor, "v"]
    lost: Float[Tensor, "v"]
    odd: Float[Tensor, "v"]
    back: Float[Tensor, "v"]
    near: Float[Tensor, "v"]

    @property
    def blind(self) -> Bool[Tensor, "v"]:
        return (self.lost >= LOST) | (self.near >= COVERED) | ((self.free == 0) & (self.back >= BURIED))


def with_sight(geometry: Geometry, tracer: Tracer, receivers: Receivers) -> tuple[Geometry, Receivers, Validity]:
    """The scene and its receivers with normals and origins that see, and which are to be filled from others.

    A receiver is *turned* if its faces cancel to a zero normal, or oppose each other so that it sees less than half of
    the hemisphere and the mean of those of its faces that see most sees twice as much. It cannot see if a quarter of
    its rays end within rounding of where they start or on the back of a face nearby (a fold of its own surface, a flap
    that lies on it), or if none escapes and half of them meet backs (it is buried in another solid). It is then
    *moved* along the direction that is in front of all of its faces, if it sees from there; else it is to be
    *filled*. In a closed surface of consistent winding that does not cut itself, nothing is touched.

    Source: Rays on back faces as a sign are what lightmap bakers call validity.
    """
    scene = _Scene(geometry, tracer)
    sight = torch.zeros(len(receivers), dtype=torch.uint8)
    geometry, receivers = _turned(scene, receivers, sight)
    alive = torch.nonzero((receivers.normals != 0).any(-1))[:, 0]
    glance = scene.views(receivers, alive, GLANCE)
    folded = _least_cosine(geometry, receivers)[alive] < 0
    chosen = (glance.odd > 0) | (glance.near >= NEAR / 2) | (glance.free == 0) | folded
    suspects, folded = alive[chosen], folded[chosen]
    views = scene.views(receivers, suspects, LOOK)
    doubtful = (views.odd >= ODD) | (views.near >= NEAR) | folded
    wrong = views.blind | _darker(scene, receivers, suspects, views, doubtful & ~views.blind)
    rows = suspects[wrong]
    moved, origins = _moved(scene, receivers, rows, views.free[wrong])
    sight[rows] = int(Sight.FILLED)
    sight[rows[moved]] = int(Sight.MOVED)
    replaced = receivers.origins.clone()
    replaced[rows[moved]] = origins[moved]
    receivers = dataclasses.replace(receivers, origins=replaced)
    # Faces without area leave no normal to turn to.
    sight[scene.used & (receivers.normals == 0).all(-1)] = int(Sight.FILLED)
    return geometry, receivers, filling(geometry, receivers.normals, sight)


@dataclass
class _Scene:
    """What is asked again and again: the geometry, and of its receivers the sides that meet there."""

    geometry: Geometry
    tracer: Tracer

    def __post_init__(self) -> None:
        geometry = self.geometry
        self.size, _ = around_receivers(geometry)
        self.used = torch.zeros(geometry.receivers, dtype=torch.bool)
        self.used[geometry.display_faces.flatten()] = True
        self.places = self.tracer.local(geometry.positions)
        piece, closed = _pieces(geometry)
        # The back of a two-sided sheet is as good as its front, unless it encloses something.
        self.solid = ~geometry.two_sided | closed[piece]
        self.piece = torch.where(closed[piece], _ANY, piece)
        self.own = torch.full((geometry.receivers,), -1)
        for numbering in (geometry.receiver_of_vertex, geometry.back_receiver_of_vertex):
            of_corners = numbering[geometry.faces]
            self.own[of_corners[of_corners >= 0]] = piece[:, None].expand(-1, 3)[of_corners >= 0]
        self.reverse = torch.zeros(geometry.receivers, dtype=torch.bool)
        self.reverse[geometry.back_receiver_of_vertex[geometry.back_receiver_of_vertex >= 0]] = True

    def views(self, receivers: Receivers, rows: Int[Tensor, "v"], rays: int) -> _Views:
        """What `rows` of the receivers see of the scene with that many rays."""
        return self.look(receivers[rows], rows, rays)

    def look(self, some: Receivers, rows: Int[Tensor, "v"], rays: int) -> _Views:
        """The same of receivers that stand where `rows` do."""
        size, reverse, own = self.size[rows], self.reverse[rows], self.own[rows]
        directions = hemisphere(rays).float()
        shares = torch.zeros(5, len(some), dtype=torch.float64)
        turned, start = some.frames(), self.tracer.local(some.points)
        lift = torch.linalg.vector_norm(some.origins.double() - start, dim=-1)
        reach = 2 * size * self.tracer.scale
        for block in some.blocks(rays):
            hits = self.tracer.hits(some.origins[block], turned[block], directions)
            meets = hits.triangle >= 0
            triangle = hits.triangle.long().clamp(min=0)
            weights = torch.stack([1 - hits.u - hits.v, hits.u, hits.v], -1).double()
            ends = (self.places[self.geometry.faces[triangle]] * weights[..., None]).sum(-2)
            far = torch.linalg.vector_norm(ends - start[block][:, None], dim=-1)
            sheet = self.geometry.two_sided[triangle] & reverse[block][:, None]
            back = meets & ~hits.front & self.solid[triangle] & ~sheet
            near = meets & (far <= 4 * lift[block][:, None])
            piece = self.piece[triangle]
            inside = back & ((piece == own[block][:, None]) | (piece == _ANY))
            close = far <= reach[block][:, None]
            found = (~meets, inside & close, back & close, back, near)
            shares[:, block] = torch.stack(found).double().mean(-1)
        return _Views(*shares)


def _pieces(geometry: Geometry) -> tuple[Int[Tensor, "F"], Bool[Tensor, "P"]]:
    """The connected piece of surface of each face, and which pieces are closed: their backs are inside.

    A piece is closed if no edge has a single face."""
    faces = weld(geometry.positions.numpy())[geometry.faces.numpy()]
    count = int(faces.max()) + 1
    ends = (faces.ravel(), np.roll(faces, -1, axis=1).ravel())
    graph = coo_matrix((np.ones(faces.size, bool), ends), (count, count))
    _, label = connected_components(graph, directed=False)
    piece = label[faces[:, 0]]
    sides = edges(faces)
    closed = np.ones(label.max() + 1, dtype=bool)
    closed[piece[sides.face[sides.start[sides.count == 1]]]] = False
    return torch.from_numpy(piece.astype(np.int64)), torch.from_numpy(closed)


def _darker(
    scene: _Scene, receivers: Receivers, rows: Tensor, views: _Views, doubtful: Bool[Tensor, "v"]
) -> Bool[Tensor, "v"]:
    """Whether doubtful receivers see much less than the median of what their neighbours see."""
    result = torch.zeros(len(rows), dtype=torch.bool)
    chosen = rows[doubtful]
    if not len(chosen):
        return result
    ring = _ring(scene.geometry, chosen)
    around, number = ring[:, 1].unique(return_inverse=True)
    free = scene.views(receivers, around, LOOK).free
    known = torch.zeros(len(receivers), dtype=torch.float64)
    known[rows] = views.free
    result[doubtful] = known[chosen] < DARKER * _medians(ring[:, 0], free[number], chosen)
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


@dataclass
class _Sides:
    """The faces that meet at some receivers, one after the other: of which `row` (a number among those receivers), and
    each with its `normal`, `area` and the direction `inward` from the receiver to its middle."""

    row: Int[Tensor, "s"]
    normal: Float[Tensor, "s 3"]
    area: Float[Tensor, "s"]
    inward: Float[Tensor, "s 3"]


def _sides(geometry: Geometry, rows: Int[Tensor, "v"]) -> _Sides:
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
    inward = torch.nn.functional.normalize(corners.mean(1, keepdim=True) - corners, dim=-1)
    face, corner = torch.nonzero((number[faces] >= 0) & (normal != 0).any(-1, keepdim=True), as_tuple=True)
    return _Sides(number[faces[face, corner]], normal[face], area[face], inward[face, corner])


def _turned(scene: _Scene, receivers: Receivers, sight: Tensor) -> tuple[Geometry, Receivers]:
    """Receivers whose normal is missing, or wrong for most of their faces, with one that sees."""
    geometry = scene.geometry
    rows = _creased(scene, receivers)
    if not len(rows):
        return geometry, receivers
    sides = _sides(geometry, rows)
    row = rows[sides.row]
    each = _looking(scene, receivers, row, sides.normal, sides.inward)
    free = scene.look(each, row, LOOK).free
    # Of sides that see alike the largest; the front of a sheet of two sides is where most of its area faces.
    size = sides.area / _most(sides.row, sides.area, len(rows))[sides.row]
    score = torch.where(_single(geometry)[row], free + 1e-4 * size, size)
    best = _first_of_most(sides.row, score, len(rows))
    agree = ((sides.normal * sides.normal[best.clamp(min=0)][sides.row]).sum(-1) > CREASED).double()[:, None]
    none = torch.zeros(len(rows), 3, dtype=torch.float64)
    normals = none.index_add(0, sides.row, agree * sides.area[:, None] * sides.normal)
    normals = torch.nn.functional.normalize(normals, dim=-1)
    count = none[:, :1].index_add(0, sides.row, agree).clamp(min=1)
    inward = none.index_add(0, sides.row, agree * sides.inward) / count
    turned = _looking(scene, receivers, rows, normals, inward)
    after = scene.look(turned, rows, LOOK).free
    before = scene.views(receivers, rows, LOOK).free
    missing = (receivers.normals[rows] == 0).all(-1)
    better = (best >= 0) & (missing | (after >= 2 * before.clamp(min=1 / LOOK)))
    rows, turned, inward = rows[better], turned[better], inward[better]
    # The other side of a sheet looks the other way.
    front, back = geometry.receiver_of_vertex, geometry.back_receiver_of_vertex
    both = (front >= 0) & (back >= 0)
    other = torch.full((geometry.receivers,), -1)
    other[front[both]] = back[both]
    sheets = other[rows] >= 0
    behind = other[rows[sheets]]
    reverse = _looking(scene, receivers, behind, -turned.normals[sheets], inward[sheets])
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


def _creased(scene: _Scene, receivers: Receivers) -> Int[Tensor, "v"]:
    """Receivers without normal, and those of one side whose normal opposes a face and that see less than half."""
    geometry = scene.geometry
    missing = scene.used & (receivers.normals == 0).all(-1) & ~scene.reverse
    oppose = _least_cosine(geometry, receivers) < CREASED
    rows = torch.nonzero(oppose & _single(geometry) & (receivers.normals != 0).any(-1))[:, 0]
    rows = rows[scene.views(receivers, rows, GLANCE).free < 0.5]
    return torch.cat([torch.nonzero(missing)[:, 0], rows])


def _least_cosine(geometry: Geometry, receivers: Receivers) -> Float[Tensor, "V"]:
    """The least cosine between the normal of each receiver and those of its faces; 1 without faces."""
    faces = geometry.display_faces
    normal = torch.from_numpy(face_normals(geometry.receiver_positions.numpy(), faces.numpy()))
    least = torch.ones(geometry.receivers, dtype=torch.float64)
    for corner in faces.unbind(-1):
        cosine = (normal * receivers.normals[corner]).sum(-1)
        cosine = torch.where((normal != 0).any(-1), cosine, 1.0)
        least = least.scatter_reduce(0, corner, cosine, "amin")
    return least


def _looking(scene: _Scene, receivers: Receivers, rows: Tensor, normals: Tensor, inward: Tensor) -> Receivers:
    """`rows` of the receivers with other normals, and origins as `vertex_receivers` has them."""
    points = receivers.points[rows]
    away = inward - (inward * normals).sum(-1, keepdim=True) * normals + normals
    return Receivers(points, normals, scene.tracer.origins(points, away, scene.size[rows]))


def _moved(
    scene: _Scene, receivers: Receivers, rows: Int[Tensor, "v"], free: Float[Tensor, "v"]
) -> tuple[Bool[Tensor, "v"], Float[Tensor, "v 3"]]:
    """Origins in front of all faces of `rows`, and which of them see from there."""
    sides = _sides(scene.geometry, rows)
    direction = _in_front(sides, receivers.normals[rows])
    origins, found = receivers.origins[rows].clone(), torch.zeros(len(rows), dtype=torch.bool)
    for step in STEPS:
        tried = receivers[rows]
        tried.origins = scene.tracer.origins(tried.points, step * direction, scene.size[rows])
        views = scene.look(tried, rows, LOOK)
        better = ~found & ~views.blind & (views.free >= (2 * free).clamp(min=LOST))
        origins[better] = tried.origins[better]
        found |= better
    return found, origins


def _in_front(sides: _Sides, first: Float[Tensor, "v 3"]) -> Float[Tensor, "v 3"]:
    """For each receiver the direction whose least height over its faces is greatest (projected subgradient steps)."""
    direction = first.clone()
    if not len(sides.row):
        return direction
    for step in range(256):
        height = (sides.normal * direction[sides.row]).sum(-1)
        lowest = _first_of_most(sides.row, -height, len(first))
        push = torch.where((lowest >= 0)[:, None], sides.normal[lowest.clamp(min=0)], 0.0)
        direction = torch.nn.functional.normalize(direction + push / (2 + step), dim=-1)
    return direction


def _most(row: Tensor, values: Tensor, count: int) -> Float[Tensor, "v"]:
    return values.new_full((count,), -np.inf).scatter_reduce(0, row, values, "amax")


def _first_of_most(row: Tensor, values: Tensor, count: int) -> Int[Tensor, "v"]:
    """The first entry of each row that holds its largest value; -1 for a row without entries."""
    winners = torch.nonzero(values == _most(row, values, count)[row])[:, 0]
    best = torch.full((count,), len(values))
    best = best.scatter_reduce(0, row[winners], winners, "amin")
    return torch.where(best < len(values), best, -1)
