"""Subsurface scattering: light that arrives at a body leaves it elsewhere, as diffusion has it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int64
from scipy.sparse import coo_matrix, csr_matrix
from torch import Tensor

from torchprt.brdf import Dipole
from torchprt.scene import Geometry
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface_faces import near_faces, turn_share
from torchprt.transport.subsurface_tree import (
    Tree,
    close,
    gathered_from,
    halved,
    padded,
    profile_over,
    squares,
    tree_of,
)
from torchprt.transport.task import Once, Task

BLOCK = 64
"""Vertices that gather from the same clusters, at most."""
SPREAD = 2.0
"""How much the profile may change over a cluster, as a share; what is left of error is some thousandth of that."""

# Blocks a task, and items at a time: what is between them stays in a core's cache.
_BLOCKS, _ITEMS = 8, 512


@dataclass
class Body:
    """A body that light diffuses in: its surface, and the medium below it.

    `rows [v]` of the receivers of a bake, `positions [v, 3]` in mm, `faces [f, 3]` over them, the `source` of light
    that diffuses, and what share of arriving light is `entering`."""

    rows: Int64[Tensor, "v"]
    positions: Float64[Tensor, "v 3"]
    faces: Int64[Tensor, "f 3"]
    source: Dipole
    entering: float
    spread: float = SPREAD
    asked: int | None = None
    """How many vertices, the first of them, are asked what leaves them; None for all."""
    once: Once = field(default_factory=Once, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        corners = self.positions[self.faces]
        one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self.area = torch.linalg.cross(one, two).norm(dim=-1) / 2
        self.size = torch.stack([one, two, two - one]).norm(dim=-1).amax(0)
        self.turn = turn_share(self.positions, self.faces)

    def seen(self, tree: Tree, vertices: Int64[Tensor, "b"], items: Int64[Tensor, "t"]) -> Seen:
        """Some items of a tree from some vertices."""
        points = self.positions[vertices]
        middle = points.mean(0)
        moments = tree.moments[items].float()
        square, along, vectors = squares((points - middle).float(), (tree.centre[items] - middle).float(), moments)
        # Clusters that are taken as one hold no face that is near.
        size = torch.where(items < tree.clusters, 0, tree.size[items]).float()
        return Seen(square, along, moments[:, :3].sum(-1), vectors, close(square, size, self.source))


@dataclass(frozen=True)
class Seen:
    """Items from vertices: what `profile_over` takes, and which are faces so `near` that it will not do."""

    square: Float[Tensor, "b t"]
    along: Float[Tensor, "b t"]
    spread: Float[Tensor, "t"]
    vectors: list[Float[Tensor, "b t"]]
    near: Bool[Tensor, "b t"]


@dataclass(frozen=True, eq=False)
class Paths:
    """How light gets around in a body: a tree of its faces, and its vertices in blocks that gather from the same items.

    `blocks [B, b]` are vertices; where their `own` is False they stand in another block, too, so that all are full.
    Vertices of a block gather from its `items` of the tree, and each by itself from faces `near` it: a matrix `[v, v]`
    a colour."""

    tree: Tree
    blocks: Int64[Tensor, "B b"]
    own: Bool[Tensor, "B b"]
    items: list[Int64[Tensor, "_"]]
    near: list[csr_matrix]


@dataclass(frozen=True)
class Reaching(Task):
    """From which "items" some blocks gather, "counts" of them a block, and the entries of their rows of the near
    matrices: "row" and "column" `[E]`, "entry" `[C, E]`."""

    def compute(self, body: Body, tree: Tree, blocks: Tensor, own: Tensor) -> dict[str, Tensor]:
        here, mine = blocks[self.index], own[self.index]
        places = body.positions[here]
        centre = places.mean(1)
        radius = (places - centre[:, None]).norm(dim=-1).amax(1)
        items, starts = gathered_from(tree, body.source, centre, radius, body.spread, float(body.area.sum()))
        vertices, faces = [], []
        for block, some in enumerate(items.tensor_split(starts[1:-1])):
            near = body.seen(tree, here[block], some).near
            who, what = torch.nonzero(near & mine[block][:, None], as_tuple=True)
            vertices.append(here[block][who])
            faces.append(tree.order[some[what] - tree.clusters])
        vertex, face = torch.cat(vertices), torch.cat(faces)
        row, column, entry = near_faces(body.positions, body.faces, vertex, face, body.source, body.turn)
        return {"items": items, "counts": starts.diff(), "row": row, "column": column, "entry": entry.float()}


@dataclass(frozen=True)
class Gathering(Task):
    """What is "leaving" `[blocks, b, C, W]` at some blocks, but for what comes from near. `values [C or 1, 4, I, W]`:
    what enters the items, and its first moments along x, y and z."""

    def compute(self, body: Body, paths: Paths, values: Tensor) -> dict[str, Tensor]:
        blocks, colours = paths.blocks[self.index], len(body.source.real)
        found = torch.zeros(*blocks.shape, colours, values.shape[-1])
        assert isinstance(self.rows, slice)
        for number, (vertices, items) in enumerate(zip(blocks, paths.items[self.rows], strict=True)):
            for some in items.split(_ITEMS):
                seen, sent = body.seen(paths.tree, vertices, some), values[:, :, some]
                for colour in range(colours):
                    sums, *firsts = sent[colour % len(sent)]
                    weights, change = profile_over(seen.square, seen.along, seen.spread, body.source, colour)
                    found[number, :, colour].addmm_(weights.masked_fill_(seen.near, 0), sums)
                    change.masked_fill_(seen.near, 0)
                    for apart, first in zip(seen.vectors, firsts, strict=True):
                        found[number, :, colour].addmm_(change * apart, first)
        return {"leaving": found}


def diffused(body: Body, arriving: Float[Tensor, "v W"], channels: int, stages: Stages) -> Float[Tensor, "asked D"]:
    """What leaves the vertices of a body that are asked, as a diffuse surface that reflected all of it would send it.

    `arriving` has the coefficients of 1 channel or of one a colour side by side, what leaves of one a colour. Linear. A
    row of weights adds up to at most 1: the dipole is that of a half-space, and where a body is thin more would leave
    its two sides than came.
    Source: Jensen and Buhler 2002, sections 2 and 3; what leaves is spread evenly over the directions.
    """
    if not len(body.faces):
        return torch.zeros(len(arriving), len(body.source.real) * (arriving.shape[1] // channels))
    paths = body.once("paths", lambda: paths_of(body, stages))
    colours, count = len(body.source.real), len(body.positions)
    # A column of ones goes along: it becomes the sum of the weights.
    light = arriving.view(count, channels, -1)
    light = torch.cat([light, torch.ones(count, channels, 1)], -1).permute(1, 0, 2).contiguous()
    values = torch.stack([entering_items(body, paths.tree, each) for each in light])
    near = [matrix @ light[colour % channels].numpy() for colour, matrix in enumerate(paths.near)]
    found = torch.from_numpy(np.stack(near, 1))
    for task, some in stages.run("diffusion", tasks_of(paths.blocks, Gathering), body, paths, values):
        mine = paths.own[task.index]
        found[paths.blocks[task.index][mine]] += some["leaving"][mine]
    scale = body.entering / found[..., -1:].clamp(min=1)
    return (found[..., :-1] * scale).view(len(found), colours * (light.shape[-1] - 1))


def bodies_of(geometry: Geometry) -> tuple[Body, ...]:
    """The bodies of a scene: the objects that have a medium below their surface."""
    found = []
    for number, (medium, rows) in enumerate(zip(geometry.media, geometry.slices, strict=False)):
        if medium is not None:
            below, millimetres = medium
            mine = (geometry.receiver_of_vertex >= rows.start) & (geometry.receiver_of_vertex < rows.stop)
            places = geometry.positions[mine] - geometry.positions[mine].mean(0)
            faces = geometry.receiver_of_vertex[geometry.faces[geometry.face_object == number]] - rows.start
            found.append(
                Body(torch.arange(rows.start, rows.stop), places * millimetres, faces, below.dipole, below.entering)
            )
    return tuple(found)


def unshadowed_through(vectors: Float[Tensor, "V W"], bodies: tuple[Body, ...], stages: Stages) -> Float[Tensor, "V D"]:
    """What leaves all receivers of `vectors` of one channel, those of bodies in three colours."""
    if not bodies:
        return vectors
    found = vectors.repeat(1, 3)
    for body in bodies:
        found[body.rows] = diffused(body, vectors[body.rows], 1, stages)
    return found


def entering_items(body: Body, tree: Tree, light: Float[Tensor, "v W"]) -> Float[Tensor, "4 I W"]:
    """What enters the items of a tree, linear over each face, and its first moments along x, y and z."""
    corners = body.positions[body.faces]
    arms = (corners - corners.mean(1, keepdim=True)).to(light.dtype)
    area = body.area.to(light.dtype)[:, None]
    sums, firsts = torch.zeros(len(arms), light.shape[1]), torch.zeros(3, len(arms), light.shape[1])
    for corner in range(3):
        at = light[body.faces[:, corner]] * area
        sums.add_(at, alpha=1 / 3)
        for axis in range(3):
            firsts[axis].addcmul_(at, arms[:, corner, axis, None], value=1 / 12)
    total, first = tree.sums(sums, firsts)
    return torch.cat([total[None], first])


def paths_of(body: Body, stages: Stages) -> Paths:
    """How light gets around in a body."""
    tree = tree_of(body.positions[body.faces], body.area, body.size)
    every = len(body.positions)
    count = every if body.asked is None else body.asked
    leaves, full = padded(count, BLOCK)
    place = torch.arange(full) % count
    order = halved(body.positions[place], leaves)
    blocks, own = place[order], order < count
    items: list[Tensor] = [torch.zeros(0, dtype=torch.int64)] * len(blocks)
    parts = []
    for task, found in stages.run("subsurface", tasks_of(blocks, Reaching), body, tree, blocks, own):
        items[task.rows] = found["items"].split(found["counts"].tolist())
        parts.append((task.rows.start, found))
    parts.sort(key=lambda part: part[0])
    row, column, entry = (torch.cat([found[name] for _, found in parts], -1) for name in ("row", "column", "entry"))
    where = row.numpy(), column.numpy()
    near = [coo_matrix((each.numpy(), where), (count, every)).tocsr() for each in entry]
    return Paths(tree, blocks, own, items, near)


def tasks_of(blocks: Tensor, kind: type[Reaching] | type[Gathering]) -> list:
    """Tasks over all blocks."""
    return [kind(slice(start, min(start + _BLOCKS, len(blocks)))) for start in range(0, len(blocks), _BLOCKS)]
