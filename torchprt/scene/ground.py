"""A ground to stand on: a disc that is fine where shadows are, coarse where there is nothing to see."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.trace import Tracer

from .material import Albedo, Material
from .mesh import Mesh, make_mesh
from .object import Object

REACH = 8.0
"""Radius of the disc, in radii of what stands on it: from there its shadow is nothing, and pictures have faded."""
FINE, COARSENING = 1 / 40, 0.12
"""Edges under the model, in radii of its outline seen from above; outward they grow by this share of the way."""
GAP = 1e-4
"""How far below its height the disc lies, in radii of the model: what stands on the height must not lie in the disc."""
CLOSE = 3e-2
"""How near above the ground, in radii of the model, something covers it."""
BESIDE = 2e-3
"""How far, in radii of the model, from its outline vertices are put: many times the gap, through which they would look
under it."""
HALVINGS = 12
FLATTEST = 0.05
"""Share of its area that a triangle must keep."""


def ground(objects: Sequence[Object], height: float | None = None, albedo: Albedo = 0.5) -> list[Object]:
    """The disc under `objects` at `height` along +y (the lowest point of all but blockers by default), as an object.

    Its middle is below theirs, its radius `REACH` times theirs, and its vertices stand closest below them. Where the
    outline of what stands on it crosses its triangles, vertices are moved onto the outline: between one that sees the
    sky and one that something covers, light would end in the teeth of the triangles. If anything reaches below it, a
    second object closes it from beneath, black: no light comes from there.

    Raises InputError if there is a ground already, if `height` is not finite or above everything, or as `Material`.
    """
    if any(object.role == "ground" for object in objects):
        raise InputError("the scene has a ground already: leave one of the two out")
    receiving = torch.cat([object.mesh.positions for object in objects if object.role != "blocker"])
    everything = torch.cat([object.mesh.positions for object in objects])
    low, high = receiving.amin(0), receiving.amax(0)
    top = float(everything[:, 1].amax())
    level = float(low[1]) if height is None else float(height)
    if not math.isfinite(level):
        raise InputError(f"height of the ground is {level}: give a finite number")
    if level >= top:
        raise InputError(f"height of the ground is {level:g}, and nothing reaches above {top:g}: give a lower one")
    middle = (low + high) / 2
    radius = float((receiving - middle).norm(dim=-1).amax())
    outline = float((receiving - middle)[:, [0, 2]].norm(dim=-1).amax())
    disc, faces = _disc(max(outline, 0.1 * radius), REACH * radius)
    level -= GAP * radius
    points = disc + torch.stack([middle[0], torch.tensor(level, dtype=torch.float64), middle[2]])
    points = _onto_outline(points, faces, _Cover(objects, CLOSE * radius), BESIDE * radius)
    up = torch.tensor([[0.0, 1.0, 0.0]]).expand(len(points), 3)
    found = [Object(make_mesh(points, faces, normals=up, name="ground"), Material(albedo), "ground")]
    depth = level - float(everything[:, 1].amin())
    if depth > 0:
        found.append(Object(_underside(points, depth), Material(0.0), "blocker"))
    return found


def _disc(fine: float, radius: float) -> tuple[Float64[Tensor, "V 3"], Int64[Tensor, "F 3"]]:
    """Rings around the origin at y = 0, facing +y: even triangles up to `fine`, growing from there to `radius`."""
    edge = FINE * fine
    radii = [0.0]
    while radii[-1] < radius:
        radii.append(radii[-1] + edge + COARSENING * max(0.0, radii[-1] - 1.1 * fine))
    radii[-1] = radius
    counts = [1]
    for before, here in itertools.pairwise(radii):
        counts.append(max(6, round(2 * math.pi * here / (here - before))))
    # The last step may be a short one.
    counts[-1] = counts[-2]
    points, faces, start = [], [], 0
    for number, (ring, count) in enumerate(zip(radii, counts, strict=True)):
        angle = 2 * math.pi * np.arange(count) / count
        points.append(np.stack([ring * np.cos(angle), np.zeros(count), -ring * np.sin(angle)], -1))
        if number:
            faces.append(_between(counts[number - 1], count, start - counts[number - 1], start))
        start += count
    return torch.from_numpy(np.concatenate(points)), torch.from_numpy(np.concatenate(faces))


def _between(inner: int, outer: int, first_inner: int, first_outer: int) -> np.ndarray:
    """Triangles between two rings of evenly spaced vertices: a side of either, and the nearest vertex of the other."""
    a, b = np.arange(inner), np.arange(outer)
    middle_a, middle_b = (a + 0.5) / inner, (b + 0.5) / outer
    across = np.searchsorted(middle_b, middle_a, "left") % outer
    back = np.searchsorted(middle_a, middle_b, "right") % inner
    inward = np.stack([b + first_outer, (b + 1) % outer + first_outer, back + first_inner], -1)
    if inner == 1:
        return inward
    outward = np.stack([a + first_inner, across + first_outer, (a + 1) % inner + first_inner], -1)
    return np.concatenate([outward, inward])


class _Cover:
    """Whether something stands on a point of the ground, or around it."""

    def __init__(self, objects: Sequence[Object], close: float):
        starts = np.cumsum([0] + [len(object.mesh.positions) for object in objects[:-1]]).tolist()
        self._positions = torch.cat([object.mesh.positions for object in objects])
        self._faces = torch.cat([o.mesh.faces + start for o, start in zip(objects, starts, strict=True)])
        self._sheet = torch.cat([o.two_sided[o.mesh.faces].all(1) for o in objects])
        self._tracer = Tracer(self._positions, self._faces)
        self._close = close

    def __call__(self, points: Float64[Tensor, "p 3"]) -> Bool[Tensor, "p"]:
        """Points from which the way up ends at the inner side of a surface, or at once."""
        up = torch.tensor([[0.0, 1.0, 0.0]])
        origins = self._tracer.local(points).to(torch.float32)
        hits = self._tracer.hits(origins, torch.eye(3).expand(len(points), 3, 3).contiguous(), up)
        triangle = hits.triangle[:, 0].long()
        corners = self._positions[self._faces[triangle.clamp(min=0)]][..., 1]
        u, v = hits.u[:, 0], hits.v[:, 0]
        above = (torch.stack([1 - u - v, u, v], -1) * corners).sum(-1) - points[:, 1]
        inside = ~hits.front[:, 0] & ~self._sheet[triangle.clamp(min=0)]
        return (triangle >= 0) & (inside | (above < self._close))


def _onto_outline(
    points: Float64[Tensor, "V 3"], faces: Int64[Tensor, "F 3"], cover: _Cover, beside: float
) -> Float64[Tensor, "V 3"]:
    """`points`, those nearest to the outline of what covers them moved to `beside` it, by half an edge at most.

    Source: Labelle and Shewchuk 2007, "Isosurface stuffing", the warping of vertices onto a surface.
    """
    covered = cover(points)
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).sort(-1).values.unique(dim=0)
    edges = edges[covered[edges].sum(-1) == 1]
    if not len(edges):
        return points
    hidden = torch.where(covered[edges[:, 0]], edges[:, 0], edges[:, 1])
    seeing = edges.sum(-1) - hidden
    inner, outer = points[hidden], points[seeing]
    for _ in range(HALVINGS):
        between = (inner + outer) / 2
        under = cover(between)[:, None]
        inner, outer = torch.where(under, between, inner), torch.where(under, outer, between)
    outer = outer + beside * torch.nn.functional.normalize(points[seeing] - points[hidden], dim=-1)
    way = (outer - points[hidden]).norm(dim=-1), (outer - points[seeing]).norm(dim=-1)
    mover = torch.where(way[0] <= way[1], hidden, seeing)
    # The shortest way of each vertex comes last, and stays.
    order = torch.minimum(*way).argsort(descending=True)
    moved = points.clone()
    for vertex, place in zip(mover[order].tolist(), outer[order], strict=True):
        moved[vertex] = place
    # Two neighbours that moved toward each other may have turned a triangle over: they go back.
    whole = _areas(points, faces)
    while bool((folded := _areas(moved, faces) < FLATTEST * whole).any()):
        back = faces[folded].flatten()
        moved[back] = points[back]
    return moved


def _areas(points: Float64[Tensor, "V 3"], faces: Int64[Tensor, "F 3"]) -> Float64[Tensor, "F"]:
    """Twice the areas of triangles at y = 0, negative if they face down."""
    a, b, c = points[faces].unbind(1)
    return torch.linalg.cross(b - a, c - a)[:, 1]


def _underside(points: Float64[Tensor, "V 3"], depth: float) -> Mesh:
    """A cone from the rim of the disc to below everything, facing down."""
    middle = points.mean(0)
    far = (points - middle).norm(dim=-1)
    rim = points[far > far.amax() * (1 - 1e-6)]
    rim = rim[torch.atan2(rim[:, 2] - middle[2], rim[:, 0] - middle[0]).argsort()]
    tip = middle - torch.tensor([0.0, 2 * depth, 0.0], dtype=torch.float64)
    a = torch.arange(len(rim))
    faces = torch.stack([a, (a + 1) % len(rim), torch.full_like(a, len(rim))], -1)
    return make_mesh(torch.cat([rim, tip[None]]), faces, name="ground (underside)")
