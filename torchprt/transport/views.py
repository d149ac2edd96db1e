"""What receivers see of the surface around them: how much escapes, and how much ends where no ray should."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.scene.weld import edges, weld
from torchprt.trace import Tracer
from torchprt.transport.directions import hemisphere
from torchprt.transport.receivers import Receivers
from torchprt.transport.solve import around_receivers
from torchprt.transport.task import Runner, Task

# The share of rays that meet what no ray from an outer side can meet, from which on a receiver is blind.
LOST = 0.25
# If no ray escapes at all: the share of rays that meet the back of any face.
BURIED = 0.5
# The share of rays within rounding of where they start: where two walls stand on a floor it is three quarters.
COVERED = 0.85
# In place of the number of a piece of surface: those that enclose something hide any receiver.
_ANY = -2


@dataclass
class Views:
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


@dataclass
class Viewer:
    """Looks from the receivers of a scene: which are `used` by a face, `reverse` sides, the `size` of their faces."""

    geometry: Geometry
    tracer: Tracer
    runner: Runner

    def __post_init__(self) -> None:
        geometry = self.geometry
        self.size, _ = around_receivers(geometry)
        self.used = torch.zeros(geometry.receivers, dtype=torch.bool)
        self.used[geometry.display_faces.flatten()] = True
        self.places = self.tracer.local(geometry.positions)
        piece, closed = pieces(geometry)
        # The back of a two-sided sheet is as good as its front, unless it encloses something.
        self.solid = ~geometry.two_sided | closed[piece]
        self.piece = torch.where(closed[piece], _ANY, piece)
        self.own = torch.full((geometry.receivers,), -1)
        for numbering in (geometry.receiver_of_vertex, geometry.back_receiver_of_vertex):
            of_corners = numbering[geometry.faces]
            self.own[of_corners[of_corners >= 0]] = piece[:, None].expand(-1, 3)[of_corners >= 0]
        self.reverse = torch.zeros(geometry.receivers, dtype=torch.bool)
        self.reverse[geometry.back_receiver_of_vertex[geometry.back_receiver_of_vertex >= 0]] = True

    def views(self, receivers: Receivers, rows: Int[Tensor, "v"], rays: int) -> Views:
        """What `rows` of the receivers see of the scene with that many rays."""
        return self.look(receivers[rows], rows, rays)

    def look(self, some: Receivers, rows: Int[Tensor, "v"], rays: int) -> Views:
        """The same of receivers that stand where `rows` do."""
        shares = torch.zeros(5, len(some), dtype=torch.float64)
        tasks = [Look(block) for block in some.blocks(rays)]
        for task, found in self.runner.map(tasks, self, some, rows, hemisphere(rays).float()):
            shares[:, task.index] = found["shares"]
        return Views(*shares)


@dataclass(frozen=True)
class Look(Task):
    """The "shares" `[5, v]` that `Views` holds, of some of the receivers that look."""

    def compute(self, viewer: Viewer, everyone: Receivers, rows: Tensor, directions: Tensor) -> dict[str, Tensor]:
        some, rows = everyone[self.index], rows[self.index]
        tracer, geometry = viewer.tracer, viewer.geometry
        hits = tracer.hits(some.origins, some.frames(), directions)
        start = tracer.local(some.points)
        lift = torch.linalg.vector_norm(some.origins.double() - start, dim=-1)[:, None]
        meets = hits.triangle >= 0
        # What is asked of a hit is asked of hits alone: most rays escape.
        row, column = torch.nonzero(meets, as_tuple=True)
        triangle, u, v = (part[row, column] for part in (hits.triangle.long(), hits.u.double(), hits.v.double()))
        ends = torch.zeros(len(row), 3, dtype=torch.float64)
        for corner, weight in zip(geometry.faces[triangle].unbind(-1), (1 - u - v, u, v), strict=True):
            ends += viewer.places[corner] * weight[:, None]
        far = torch.linalg.vector_norm(ends - start[row], dim=-1)
        of_row = rows[row]
        sheet = geometry.two_sided[triangle] & viewer.reverse[of_row]
        back = ~hits.front[row, column] & viewer.solid[triangle] & ~sheet
        near = far <= 4 * lift[row, 0]
        piece = viewer.piece[triangle]
        inside = back & ((piece == viewer.own[of_row]) | (piece == _ANY))
        close = far <= 2 * tracer.scale * viewer.size[of_row]
        counts = [
            torch.bincount(row[chosen], minlength=len(some)) for chosen in (inside & close, back & close, back, near)
        ]
        return {"shares": torch.stack([(~meets).sum(-1), *counts]).double() / len(directions)}


def pieces(geometry: Geometry) -> tuple[Int[Tensor, "F"], Bool[Tensor, "P"]]:
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
