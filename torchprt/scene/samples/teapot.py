"""A teapot: a glossy body that can show its own spout, handle and lid."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

from ..material import Material
from ..material_file import read_material
from ..object import Object
from ..scene import Scene
from .closed import closed_mesh
from .surface_nets import Field

BEADS = 96
"""Balls along spout and handle, close enough to make smooth tubes."""

BLEND = 0.022
"""Width over which parts run into each other."""

SPOUT = [(0.62, 0.32), (1.14, 0.26), (1.04, 0.98), (1.42, 1.16)]
"""Bezier points (x, y) from inside the body to the mouth, in the plane z = 0; so are those of the handle."""

HANDLE = [(-0.62, 0.98), (-1.65, 1.28), (-1.55, 0.12), (-0.70, 0.34)]

LOW, HIGH = (-1.7, -0.15, -1.15), (1.8, 1.75, 1.15)


def teapot(vertices: int = 30_000, material: Material | str = "ggx:0.3") -> Scene:
    """A closed, smooth teapot of `vertices` vertices within 2 %, some 2.9 units wide and 1.5 high, standing on y = 0.

    The spout points to +x, the handle to -x; a knob stands on a lid that a groove parts from the body. `material` is
    one, or text as `read_material` takes. The same every time.

    Raises InputError if `vertices` is below 8000 (the thin parts would be lost), and as `read_material` does.
    """
    if vertices < 8000:
        raise InputError(f"vertices is {vertices}: give at least 8000, or the thin parts are lost")
    material = read_material(material) if isinstance(material, str) else material
    mesh = closed_mesh(_field(), np.array(LOW), np.array(HIGH), vertices, "teapot")
    return Scene([Object(mesh, material)])


def _bezier(points: list[tuple[float, float]], t: Float[np.ndarray, "beads"]) -> Float[np.ndarray, "beads 3"]:
    a, b, c, d = (np.array([x, y, 0.0]) for x, y in points)
    u, t = (1 - t)[:, None], t[:, None]
    return u**3 * a + 3 * u**2 * t * b + 3 * u * t**2 * c + t**3 * d


def _field() -> Field:
    """Signed distance, or less, to all parts, blended where they meet."""
    t = np.linspace(0, 1, BEADS)
    tubes = torch.from_numpy(np.stack([_bezier(SPOUT, t), _bezier(HANDLE, t)]))
    widths = torch.from_numpy(np.stack([0.07 + 0.16 * (1 - t) ** 1.4, 0.075 + 0.0 * t]))
    mouth = tubes[0, -1] + 0.05 * torch.nn.functional.normalize(tubes[0, -1] - tubes[0, -4], dim=0)

    def field(points: Float[Tensor, "P 3"]) -> Float[Tensor, "P"]:
        pieces = [_solid(chunk, tubes.to(chunk.dtype), widths.to(chunk.dtype), mouth) for chunk in points.split(16384)]
        return torch.cat(pieces)

    return field


def _solid(
    points: Float[Tensor, "P 3"],
    tubes: Float[Tensor, "2 beads 3"],
    widths: Float[Tensor, "2 beads"],
    mouth: Float[Tensor, "3"],
) -> Float[Tensor, "P"]:
    x, y, z = points.unbind(1)
    radius = _root(x * x + z * z)
    with torch.no_grad():
        # Which ball of each tube is nearest does not change over a step: no gradient is needed for it.
        gap = torch.cdist(points, tubes.flatten(0, 1)).unflatten(1, widths.shape) - widths
        nearest = gap.argmin(dim=2)
    tube = torch.arange(2)
    tubular = (points[:, None] - tubes[tube, nearest]).norm(dim=2) - widths[tube, nearest]
    parts = [
        _ellipsoid(points, 0.60, (0.88, 0.60)),
        _ring(radius, y, 0.46, 0.06, 0.075),
        _ellipsoid(points, 1.075, (0.47, 0.14)),
        _ring(radius, y, 0.475, 1.085, 0.062),
        _ellipsoid(points, 1.22, (0.05, 0.1)),
        _ellipsoid(points, 1.38, (0.115, 0.1)),
        *tubular.unbind(1),
    ]
    solid = -BLEND * torch.logsumexp(-torch.stack(parts) / BLEND, dim=0)
    groove = _ring(radius, y, 0.385, 1.2, 0.055)
    hole = (points - mouth.to(points.dtype)).norm(dim=1) - 0.078
    cuts = torch.stack([solid, -groove, -hole, -0.01 - y])
    return BLEND * torch.logsumexp(cuts / BLEND, dim=0)


def _ellipsoid(points: Float[Tensor, "P 3"], height: float, size: tuple[float, float]) -> Float[Tensor, "P"]:
    """Distance, or less, to an ellipsoid about the axis: `size` is its radius and half its height."""
    wide, high = size
    scale = points.new_tensor([wide, high, wide])
    scaled = (points - points.new_tensor([0.0, height, 0.0])) / scale
    return min(size) * (_root(scaled.square().sum(1)) - 1)


def _ring(
    radius: Float[Tensor, "P"], y: Float[Tensor, "P"], wide: float, height: float, thick: float
) -> Float[Tensor, "P"]:
    """Distance to a torus about the axis."""
    return _root((radius - wide).square() + (y - height).square()) - thick


def _root(squared: Float[Tensor, "P"]) -> Float[Tensor, "P"]:
    # The square root has no gradient at zero.
    return (squared + 1e-12).sqrt()
