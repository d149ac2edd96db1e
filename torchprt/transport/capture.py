"""What is seen of lamps from points, with what is in the way: Embree answers."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.light.capture import Radiance
from torchprt.light.emitters import Emitter, MeshEmitter, SphereEmitter
from torchprt.scene import Mesh
from torchprt.trace import Tracer

# Of all that a point sees: the share of backs of blockers from which it counts as inside one.
ENCLOSED = 0.9


def lamps_seen(emitters: Sequence[Emitter], blockers: Sequence[Mesh] = ()) -> Radiance:
    """What `light.capture` asks: the radiance of lamps where no blocker, and no other lamp, is before them.

    `blockers`: meshes that are black and opaque from both sides; the object that is lit must not be among them: it
    shadows itself in its transfer. Gradients flow to the radiance of the lamps, not to where they are.

    Raises InputError if there is no lamp, or one is neither of triangles nor a sphere. What it returns raises
    InputError for a point that a lamp contains or touches, and for one that is inside a blocker.
    """
    if not emitters:
        raise InputError("there is no lamp: give one or more emitters")
    for each in emitters:
        if not isinstance(each, MeshEmitter | SphereEmitter):
            raise InputError(f"a lamp of class {type(each).__name__} cannot be traced: give a MeshEmitter of it")
    return _Seen(emitters, blockers)


class _Seen:
    """Rows of a table of radiance: black, then the faces of lamps, front and back, then spheres."""

    def __init__(self, emitters: Sequence[Emitter], blockers: Sequence[Mesh]) -> None:
        self.emitters = emitters
        self.spheres = [each for each in emitters if isinstance(each, SphereEmitter)]
        lamps = [each for each in emitters if isinstance(each, MeshEmitter)]
        places = [each.positions.double() for each in blockers]
        faces = [each.faces.long() for each in blockers]
        self.blocking = sum(len(each) for each in faces)
        places += [each.positions.detach().cpu().double() for each in lamps]
        faces += [each.faces.cpu() for each in lamps]
        shift = 0
        for number, each in enumerate(places):
            faces[number] = faces[number] + shift
            shift += len(each)
        self.positions = torch.cat(places) if places else torch.zeros(0, 3, dtype=torch.float64)
        self.faces = torch.cat(faces) if faces else torch.zeros(0, 3, dtype=torch.long)
        self.tracer = Tracer(self.positions, self.faces) if len(self.faces) else None
        front = [each.radiance.expand(len(each.faces), 3) for each in lamps]
        back = [value if each.two_sided else torch.zeros_like(value) for value, each in zip(front, lamps, strict=True)]
        rows = [*front, *back, *(each.radiance[None] for each in self.spheres)]
        dtype = rows[0].dtype
        self.table = torch.cat([torch.zeros(1, 3, dtype=dtype), *(each.cpu().to(dtype) for each in rows)])
        self.shining = len(self.faces) - self.blocking

    def __call__(self, points: Float[Tensor, "P 3"], directions: Float[Tensor, "D 3"]) -> Float[Tensor, "P D 3"]:
        for each in self.emitters:
            each.check_clear(points)
        places, ways = points.detach().cpu().double(), directions.detach().cpu().double()
        row, distance = self._triangles(places, ways)
        for number, lamp in enumerate(self.spheres):
            steps = lamp.center.detach().cpu().double() - places
            along = steps @ ways.T
            radius = float(lamp.radius)
            inside = radius**2 - (steps.square().sum(-1)[:, None] - along.square())
            near = along - inside.clamp(min=0).sqrt()
            first = (inside >= 0) & (near > 0) & (near < distance)
            row = torch.where(first, 1 + 2 * self.shining + number, row)
            distance = torch.where(first, near, distance)
        return self.table[row].to(points)

    def _triangles(self, points: Tensor, directions: Tensor) -> tuple[Tensor, Tensor]:
        shape = len(points), len(directions)
        row = torch.zeros(shape, dtype=torch.long)
        distance = torch.full(shape, torch.inf, dtype=torch.float64)
        if self.tracer is None:
            return row, distance
        frames = torch.eye(3, dtype=torch.float32).expand(len(points), 3, 3)
        origins = self.tracer.origins(points, torch.zeros_like(points))
        found = self.tracer.hits(origins, frames, directions.float())
        triangle = found.triangle.long()
        hit = triangle >= 0
        self._check_outside(points, (hit & (triangle < self.blocking) & ~found.front).double().mean(1))
        corners = self.positions[self.faces[triangle.clamp(min=0)]]
        u, v = found.u.double()[..., None], found.v.double()[..., None]
        place = (1 - u - v) * corners[..., 0, :] + u * corners[..., 1, :] + v * corners[..., 2, :]
        distance = torch.where(hit, (place - points[:, None]).norm(dim=-1), distance)
        shines = hit & (triangle >= self.blocking)
        side = torch.where(found.front, 0, self.shining)
        return torch.where(shines, 1 + triangle - self.blocking + side, row), distance

    def _check_outside(self, points: Tensor, backs: Tensor) -> None:
        enclosed = (backs >= ENCLOSED).nonzero()[:, 0]
        if len(enclosed):
            place = ", ".join(f"{value:.4g}" for value in points[enclosed[0]].tolist())
            raise InputError(
                f"sample point {int(enclosed[0])} at ({place}) is inside a blocker, where nothing is seen: leave that "
                "out, or move the object away"
            )
