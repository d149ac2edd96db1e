"""Lamps that are near: the light that arrives from them at points, and how it changes from place to place."""

from __future__ import annotations

import abc
import functools
import importlib
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.light.analytic import sphere
from torchprt.light.triangles import closest, solid_angles, triangle_lights
from torchprt.sh.basis import values_are_at_hand
from torchprt.transfer import Transfer

# Of its size: how near a lamp may come to what it lights.
TOUCHES = 1e-6


class Emitter(abc.ABC):
    """A lamp: its place and size in the world, and its `radiance`, the same in all directions that it shines in.

    Gradients flow to its tensors, whatever they are made of: numbers, lists or tensors. Making one raises InputError if
    a value is not finite, radiance is negative, or there is nothing that shines.
    """

    radiance: Tensor

    @abc.abstractmethod
    def light(self, points: Float[Tensor, "*S 3"], order: int) -> Float[Tensor, "*S N 3"]:
        """What arrives at points where nothing is in the way, as a light of `order` bands."""

    @abc.abstractmethod
    def clearance(self, points: Float[Tensor, "S 3"]) -> Float[Tensor, "S"]:
        """How far points are from the lamp at least, in units of its size, without gradients; 0 or less inside it."""

    def check_clear(self, points: Float[Tensor, "S 3"], what: str = "sample point") -> None:
        """InputError if one of the points, each a `what`, is in the lamp or touches it."""
        if not values_are_at_hand(points, *self.tensors()):
            return
        touching = (self.clearance(points.detach()) <= TOUCHES).nonzero()[:, 0]
        if len(touching):
            place = ", ".join(f"{value:.4g}" for value in points[touching[0]].tolist())
            raise InputError(
                f"{self.name} contains or touches {what} {int(touching[0])} at ({place}): move it away, or make it "
                "smaller"
            )

    name = "the lamp"

    def tensors(self) -> list[Tensor]:
        """All its tensors."""
        return [value for value in vars(self).values() if isinstance(value, Tensor)]


@dataclass
class SphereEmitter(Emitter):
    """A sphere that shines outward: `center [3]`, `radius`, `radiance` one number or `[3]`.

    Its light is that of a disc of half angle asin(radius / distance), in closed form.
    """

    center: Any
    radius: Any
    radiance: Any

    name = "the sphere lamp"

    def __post_init__(self) -> None:
        like = _like(self.center, self.radius, self.radiance)
        self.center, self.radius = _vector(self.center, like, "center"), torch.as_tensor(self.radius, **like)
        self.radiance = _colours(self.radiance, like)
        if self.radius.ndim or _not_all(self.radius.isfinite() & (self.radius > 0)):
            raise InputError(f"radius of a sphere lamp is {self.radius.tolist()}: give a number above 0")

    def light(self, points: Float[Tensor, "*S 3"], order: int) -> Float[Tensor, "*S N 3"]:
        return sphere(self.center.to(points) - points, self.radius, self.radiance.to(points), order)

    def clearance(self, points: Float[Tensor, "S 3"]) -> Float[Tensor, "S"]:
        away = (points.double() - self.center.detach().double()).norm(dim=-1) / self.radius.detach().double()
        return away - 1


@dataclass
class MeshEmitter(Emitter):
    """Triangles that shine to the side that they face: `positions [V, 3]`, `faces [F, 3]`.

    `radiance`: one number, `[3]`, or `[F, 3]`. `two_sided`: whether they shine to both sides. A closed mesh shines
    outward. Integrated over the triangles by Gauss quadrature, in pieces that are smaller than half of their distance
    and that the highest band does not vary much across: to about 1e-6 of the light of each.
    """

    positions: Any
    faces: Any
    radiance: Any
    two_sided: bool = False

    name = "the lamp of triangles"

    def __post_init__(self) -> None:
        like = _like(self.positions, self.radiance)
        self.positions = torch.as_tensor(self.positions, **like)
        self.faces = torch.as_tensor(self.faces, device=like["device"]).long()
        if self.positions.ndim != 2 or self.positions.shape[1] != 3 or self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise InputError(
                f"a lamp of triangles has positions {list(self.positions.shape)} and faces {list(self.faces.shape)}: "
                "give [V, 3] and [F, 3]"
            )
        if _not_all(self.positions.isfinite()):
            raise InputError("positions of a lamp hold NaN or infinity: give finite numbers")
        if _not_all((self.faces >= 0) & (self.faces < len(self.positions))):
            raise InputError(
                "faces of a lamp name vertices that it does not have: give numbers below that of positions"
            )
        self.radiance = _colours(self.radiance, like, len(self.faces))
        if values_are_at_hand(self.positions) and not self.area() > 0:
            raise InputError("the triangles of a lamp have no area, so that it gives no light: give others")

    def corners(self) -> Float[Tensor, "F 3 3"]:
        """Of every face its corners, one after the other."""
        return self.positions[self.faces]

    def area(self) -> float:
        """Of all its faces."""
        first, second, third = self.corners().detach().double().unbind(1)
        return float(torch.linalg.cross(second - first, third - first).norm(dim=-1).sum() / 2)

    def light(self, points: Float[Tensor, "*S 3"], order: int) -> Float[Tensor, "*S N 3"]:
        colours = self.radiance.expand(len(self.faces), 3)
        flat = triangle_lights(
            points.reshape(-1, 3), self.corners().to(points), colours.to(points), order, self.two_sided
        )
        return flat.reshape(*points.shape[:-1], *flat.shape[1:])

    def clearance(self, points: Float[Tensor, "S 3"]) -> Float[Tensor, "S"]:
        corners, places, size = self.corners().detach().double(), points.double(), math.sqrt(self.area())
        low, high = corners.flatten(0, 1).aminmax(dim=0)
        # Of points off its bounds how far they are from them; most of a model is.
        away = torch.maximum(low - places, places - high).clamp(min=0).norm(dim=-1) / size
        near = (away <= TOUCHES).nonzero()[:, 0]
        exact = closest(places[near], corners).amin(1) / size
        # Seen from inside, a closed surface fills the sphere.
        inside = solid_angles(places[near], corners).sum(1).abs() > 2 * math.pi
        return away.index_copy(0, near, torch.where(inside & self._is_closed(), -exact, exact))

    def _is_closed(self) -> bool:
        """Whether every edge is there in both directions, wherever vertices are doubled."""
        _, same = self.positions.detach().unique(dim=0, return_inverse=True)
        begin, end = same[self.faces].flatten(), same[self.faces.roll(-1, 1)].flatten()
        forth, back = begin * len(self.positions) + end, end * len(self.positions) + begin
        return torch.equal(forth.unique(), back.unique())


@dataclass
class RectangleEmitter(MeshEmitter):
    """A rectangle, or any parallelogram: `center [3]`, `right [3]` and `up [3]` from there to the middles of two sides.

    It shines to the side from which `right` and `up` turn counter-clockwise, toward right x up, or to both.
    """

    positions: Any = None
    faces: Any = None
    radiance: Any = 1.0
    two_sided: bool = False
    center: Any = None
    right: Any = None
    up: Any = None

    name = "the rectangle lamp"

    def __init__(self, center: Any, right: Any, up: Any, radiance: Any, two_sided: bool = False) -> None:
        like = _like(center, right, up, radiance)
        self.center, self.right, self.up = (
            _vector(value, like, name) for value, name in ((center, "center"), (right, "right"), (up, "up"))
        )
        places = [self.center + a * self.right + b * self.up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        self.positions, self.faces = torch.stack(places), [[0, 1, 2], [0, 2, 3]]
        self.radiance, self.two_sided = radiance, two_sided
        super().__post_init__()


def incident(
    emitters: Sequence[Emitter], points: Float[Tensor, "S 3"], order: int, *, gradients: bool = False
) -> Float[Tensor, "K N 3"]:
    """The light of lamps at sample points, K = S, each in the world; nothing is in the way (else `transport.capture`).

    With `gradients` K = 4 S: behind the light of a point its derivatives along x, y and z, exactly, for a blend that
    takes them. Gradients flow to places, sizes and radiance of the lamps, and to `points`, whose dtype the result has.
    Raises InputError if there is no lamp, or one contains or touches a point (`Emitter.check_clear`).
    """
    if not emitters:
        raise InputError("there is no lamp: give one or more emitters")
    if _not_all(points.isfinite()):
        raise InputError("points hold NaN or infinity: give finite numbers")
    for each in emitters:
        each.check_clear(points)

    def total(places: Tensor) -> Tensor:
        return functools.reduce(torch.add, (each.light(places, order) for each in emitters))

    if not gradients:
        return total(points)
    _load_forward_mode()
    axes = torch.eye(3, dtype=points.dtype, device=points.device)
    made = [torch.func.jvp(total, (points,), (axis.expand_as(points),)) for axis in axes.unbind(0)]
    return torch.stack([made[0][0], *(slope for _, slope in made)], 1).flatten(0, 1)


def local_light(
    transfer: Transfer, emitters: Sequence[Emitter], *, environment: Float[Tensor, "N 3"] | None = None
) -> Float[Tensor, "K N 3"]:
    """The K lights of the sample points that are stored with a transfer: of lamps nearby and of an `environment`.

    What `shade.LocalLightShader` and graphs exported with `local` take, in the dtype that `shader(transfer)` works in;
    derivatives are there if the blend has a use for them. Raises InputError as `incident`, if no sample points are
    stored (`with_sample_points`), if the environment is of another order, or if a lamp contains or touches a vertex.
    """
    points, blend = transfer.receivers.sampled()
    for each in emitters:
        each.check_clear(transfer.positions, "vertex")
    rows = blend.shape[1] // len(points)
    # As the shader of the transfer wants them.
    stored = [layer.signal.dtype for layer in transfer.layers.values()]
    dtype = functools.reduce(torch.promote_types, stored, torch.float32)
    lights = incident(emitters, points, transfer.order, gradients=rows > 1).to(dtype)
    if environment is None:
        return lights
    if environment.shape != lights.shape[1:]:
        raise InputError(
            f"environment has shape {list(environment.shape)} but the transfer is of order {transfer.order}: project "
            f"it with order={transfer.order}"
        )
    # Far away: it has no derivatives.
    first = torch.arange(len(lights), device=lights.device) % rows == 0
    return lights + torch.where(first[:, None, None], environment.to(lights), 0)


def _load_forward_mode() -> None:
    """torch scripts a few functions when first asked for forward derivatives, and warns that this is going away."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        importlib.import_module("torch._decomp.decompositions_for_jvp")


def _not_all(good: Tensor) -> bool:
    return values_are_at_hand(good) and not bool(good.all())


def _like(*values: Any) -> dict[str, Any]:
    found = next((value for value in values if isinstance(value, Tensor) and value.is_floating_point()), None)
    if found is None:
        return {"dtype": torch.get_default_dtype(), "device": None}
    return {"dtype": found.dtype, "device": found.device}


def _vector(value: Any, like: dict[str, Any], name: str) -> Tensor:
    made = torch.as_tensor(value, **like)
    if made.shape != (3,) or _not_all(made.isfinite()):
        raise InputError(f"{name} of a lamp is {value}: give three finite numbers")
    return made


def _colours(value: Any, like: dict[str, Any], faces: int | None = None) -> Tensor:
    made = torch.as_tensor(value, **like)
    if made.ndim == 0:
        made = made.expand(3)
    if made.shape != (3,) and (faces is None or made.shape != (faces, 3)):
        raise InputError(f"radiance of a lamp has shape {list(made.shape)}: give one number or three")
    if _not_all(made.isfinite() & (made >= 0)):
        raise InputError(f"radiance of a lamp is {value}: give finite numbers of 0 or more")
    return made
