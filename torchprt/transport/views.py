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
        return Views(*shares)


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
