"""A carved head: sockets, lips and bands whose creases hold shadow however it is bent."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

from ..material import Albedo, Material
from ..object import Object
from ..scene import Scene
from .closed import closed_mesh

BLEND = 0.03
"""Width over which parts run into each other."""

LOW, HIGH = (-1.0, -0.15, -1.0), (1.0, 2.35, 1.15)

SOLIDS = [
    ((0.0, 1.35, -0.05), (0.52, 0.62, 0.6)),
    ((0.0, 0.95, 0.14), (0.4, 0.42, 0.42)),
    ((0.0, 0.08, -0.05), (0.72, 0.26, 0.42)),
    ((0.0, 0.72, 0.48), (0.16, 0.12, 0.13)),
    ((0.24, 1.06, 0.38), (0.15, 0.13, 0.14)),
    ((-0.24, 1.06, 0.38), (0.15, 0.13, 0.14)),
    ((0.195, 1.24, 0.475), (0.095, 0.075, 0.08)),
    ((-0.195, 1.24, 0.475), (0.095, 0.075, 0.08)),
]
"""Middles and half axes of ellipsoids: skull, jaw, shoulders, chin, cheeks, eyes."""

BARS = [
    ((0.0, 0.1, -0.08), (0.0, 1.0, -0.08), 0.29),
    ((0.08, 1.37, 0.5), (0.33, 1.34, 0.38), 0.07),
    ((-0.08, 1.37, 0.5), (-0.33, 1.34, 0.38), 0.07),
    ((0.0, 1.33, 0.52), (0.0, 1.1, 0.66), 0.062),
    ((0.0, 1.08, 0.66), (0.0, 1.08, 0.66), 0.092),
    ((0.07, 1.06, 0.6), (0.07, 1.06, 0.6), 0.055),
    ((-0.07, 1.06, 0.6), (-0.07, 1.06, 0.6), 0.055),
    ((-0.13, 0.925, 0.535), (0.13, 0.925, 0.535), 0.042),
    ((-0.11, 0.845, 0.525), (0.11, 0.845, 0.525), 0.047),
    ((0.5, 1.36, -0.05), (0.53, 1.12, 0.0), 0.1),
    ((-0.5, 1.36, -0.05), (-0.53, 1.12, 0.0), 0.1),
]
"""Ends and radii of bars: neck, brows, nose, its tip and sides, lips, ears."""

HOLLOWS = [
    ((0.2, 1.25, 0.57), (0.2, 1.25, 0.57), 0.125),
    ((-0.2, 1.25, 0.57), (-0.2, 1.25, 0.57), 0.125),
    ((-0.12, 0.886, 0.6), (0.12, 0.886, 0.6), 0.03),
    ((0.6, 1.32, -0.02), (0.6, 1.17, 0.02), 0.07),
    ((-0.6, 1.32, -0.02), (-0.6, 1.17, 0.02), 0.07),
]
"""Bars that are cut away before the eyes are set: sockets, mouth, ears."""

BANDS = [(1.52, 0.6), (1.645, 0.575), (1.77, 0.52), (1.89, 0.425), (1.99, 0.29)]
"""Heights and radii of the rings of the headdress."""


def head(vertices: int = 18_000, albedo: Albedo = 0.6) -> Scene:
    """A closed head of `vertices` vertices within 2 %, some 1.4 units wide and 2.1 high, on y = 0 and facing +z.

    The same every time.
    Raises InputError if `vertices` is below 6000: its features would be lost.
    """
    if vertices < 6000:
        raise InputError(f"vertices is {vertices}: give at least 6000, or its features are lost")
    mesh = closed_mesh(_field, np.array(LOW), np.array(HIGH), vertices, "head")
    return Scene([Object(mesh, Material(albedo))])


def _field(points: Float[Tensor, "P 3"]) -> Float[Tensor, "P"]:
    return torch.cat([_solid(chunk) for chunk in points.split(16384)])


def _solid(points: Float[Tensor, "P 3"]) -> Float[Tensor, "P"]:
    """Signed distance, or less, to the head, cut level at y = 0."""
    solids = [_ellipsoid(points, middle, size) for middle, size in SOLIDS]
    bars = [_bar(points, *bar) for bar in BARS]
    rings = [_ring(points, *band) for band in BANDS]
    carved = _join([*solids[:6], *bars, *rings])
    # A blended cut keeps the edges of sockets and mouth as soft as the joins.
    carved = -_join([-carved, *[_bar(points, *hollow) for hollow in HOLLOWS]])
    return -_join([-_join([carved, *solids[6:]]), points[:, 1]])


def _join(parts: list[Float[Tensor, "P"]]) -> Float[Tensor, "P"]:
    return -BLEND * torch.logsumexp(-torch.stack(parts) / BLEND, dim=0)


def _ellipsoid(
    points: Float[Tensor, "P 3"], middle: tuple[float, float, float], size: tuple[float, float, float]
) -> Float[Tensor, "P"]:
    scaled = (points - points.new_tensor(middle)) / points.new_tensor(size)
    return min(size) * (_root(scaled.square().sum(1)) - 1)


def _bar(
    points: Float[Tensor, "P 3"], start: tuple[float, float, float], end: tuple[float, float, float], radius: float
) -> Float[Tensor, "P"]:
    """Distance to all within `radius` of a segment."""
    a, along = points.new_tensor(start), points.new_tensor(end) - points.new_tensor(start)
    length = float(along.square().sum())
    part = ((points - a) @ along / length).clamp(0, 1) if length else points.new_zeros(len(points))
    return _root((points - a - part[:, None] * along).square().sum(1)) - radius


def _ring(points: Float[Tensor, "P 3"], height: float, radius: float) -> Float[Tensor, "P"]:
    """Distance to a torus about the axis of the skull."""
    x, y, z = points.unbind(1)
    around = _root(x * x + ((z + 0.05) / 1.1).square()) - radius + 0.07
    return _root(around.square() + (y - height).square()) - 0.07


def _root(squared: Float[Tensor, "P"]) -> Float[Tensor, "P"]:
    # The square root has no gradient at zero.
    return (squared + 1e-12).sqrt()
