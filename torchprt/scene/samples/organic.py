"""A sculpture with curling limbs, folds and hollows, which shadows itself everywhere."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

from ..material import Albedo, Material
from ..mesh import Mesh
from ..object import Object
from ..scene import Scene
from .closed import closed_mesh
from .surface_nets import Field

LOW, HIGH = 7, 5
"""Limbs that lie on the ground and limbs that rise."""

BEADS = 80
"""Balls along each limb, close enough to make a smooth tube."""

BLEND = 0.045
"""Width over which limbs run into each other."""


def organic(vertices: int = 50_000, albedo: Albedo = 0.6) -> Scene:
    """A closed, smooth shape of `vertices` vertices within 2 %, some 2.7 units wide and 2 high, standing on y = 0.

    Ringed limbs leave a hollowed body, taper, and curl over and past each other. The same every time.

    Raises InputError if `vertices` is below 8000: the thin ends would be lost.
    """
    if vertices < 8000:
        raise InputError(f"vertices is {vertices}: give at least 8000, or the thin ends are lost")
    return Scene([Object(_mesh(vertices), Material(albedo))])


def _mesh(vertices: int) -> Mesh:
    centres, radii = _limbs()
    low = (centres - radii[..., None]).amin(dim=(0, 1)).numpy() - 0.15
    high = (centres + radii[..., None]).amax(dim=(0, 1)).numpy() + 0.15
    return closed_mesh(_field(centres, radii), low, high, vertices, "organic")


def _limbs() -> tuple[Float[Tensor, "limbs beads 3"], Float[Tensor, "limbs beads"]]:
    """Centres and radii of the balls that make up the limbs; the first is the body, standing on y = 0."""
    t = np.linspace(0, 1, BEADS)
    body = np.stack([0 * t, 0.1 + 0.85 * t, 0 * t], axis=-1)
    limbs = [(body, 0.3 + 0.14 * np.sin(np.pi * np.clip(1.25 * t, 0, 1)) - 0.05 * t)]
    limbs += [
        _limb(
            k / LOW,
            start=(0.3, 0.24),
            heading=-8.0,
            curl=470 + 50 * np.sin(3 * k),
            length=2.1 + 0.3 * np.sin(2 * k),
            drift=0.9,
        )
        for k in range(LOW)
    ]
    limbs += [
        _limb(
            (k + 0.5) / HIGH,
            start=(0.2, 0.85),
            heading=70.0,
            curl=-430 + 60 * np.cos(4 * k),
            length=1.75 + 0.35 * np.cos(2 * k),
            drift=-1.3,
        )
        for k in range(HIGH)
    ]
    centres = np.stack([centre for centre, _ in limbs])
    radii = np.stack([radius for _, radius in limbs])
    centres[..., 1] -= (centres[..., 1] - radii).min()
    return torch.from_numpy(centres), torch.from_numpy(radii)


def _limb(
    turn: float, start: tuple[float, float], heading: float, curl: float, length: float, drift: float
) -> tuple[Float[np.ndarray, "beads 3"], Float[np.ndarray, "beads"]]:
    """A limb that leaves the axis at `turn` of a circle, tapers, and curls more and more tightly (degrees in all).

    `start` is its distance from the axis and its height; `drift` is how far it winds around the axis, in radians.
    """
    t = np.linspace(0, 1, BEADS)
    angle = np.radians(heading + curl * t**2.6)
    step = length / BEADS
    out = start[0] + np.cumsum(np.cos(angle)) * step
    rise = start[1] + np.cumsum(np.sin(angle)) * step
    around = 2 * np.pi * turn + drift * t**1.3
    ridges = 1 + 0.05 * np.sin(2 * np.pi * 22 * t) * np.clip(3 * t - 0.3, 0, 1)
    radius = (0.19 * (1 - t) ** 0.85 + 0.03) * ridges
    return np.stack([out * np.cos(around), rise, out * np.sin(around)], axis=-1), radius


def _field(centres: Float[Tensor, "limbs beads 3"], radii: Float[Tensor, "limbs beads"]) -> Field:
    """Distance to the limbs, blended where they meet, less a hollow in the top of the body."""
    top = float(centres[0, -1, 1])
    hollows = torch.tensor([[0.0, top + 0.28, 0.0, 0.3], [0.0, top + 0.02, 0.0, 0.16]], dtype=torch.float64)
    limb = torch.arange(len(centres))

    def field(points: Float[Tensor, "P 3"]) -> Float[Tensor, "P"]:
        balls, sizes = centres.to(points.dtype), radii.to(points.dtype)
        middles, widths = hollows.to(points.dtype).split([3, 1], dim=1)
        pieces = []
        for chunk in points.split(8192):
            with torch.no_grad():
                # Which ball of each limb is nearest does not change over a step: no gradient is needed for it.
                gap = torch.cdist(chunk, balls.flatten(0, 1)).unflatten(1, sizes.shape).sub_(sizes)
                nearest = gap.argmin(dim=2)
            distance = (chunk[:, None] - balls[limb, nearest]).norm(dim=2) - sizes[limb, nearest]
            solid = -BLEND * torch.logsumexp(-distance / BLEND, dim=1)
            hollow = (chunk[:, None] - middles).norm(dim=2) - widths[:, 0]
            pieces.append(BLEND * torch.logsumexp(torch.cat([solid[:, None], -hollow], dim=1) / BLEND, dim=1))
        return torch.cat(pieces)

    return field
