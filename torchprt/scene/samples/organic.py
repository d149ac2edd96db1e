"""A sculpture with curling limbs, folds and hollows, which shadows itself everywhere."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

from ..material import Albedo, Material
from ..mesh import Mesh, make_mesh
from ..object import Object
from ..scene import Scene
from .surface_nets import surface_nets

LIMBS = 7
BEADS = 72
"""Balls along each limb, close enough to make a smooth tube."""


def organic(vertices: int = 50_000, albedo: Albedo = 0.6) -> Scene:
    """A closed, smooth shape of about `vertices` vertices (within 2 %), some 2.5 units wide and high, standing on y = 0.

    Limbs rise from a hollowed body, curl around each other and taper to their ends. The same every time.

    Raises InputError if `vertices` is below 5000: the thin ends would be lost.
    """
    if vertices < 5000:
        raise InputError(f"vertices is {vertices}: give at least 5000, or the thin ends are lost")
    return Scene([Object(_mesh(vertices), Material(albedo))])


def _mesh(vertices: int) -> Mesh:
    centres, radii = _limbs()
    low = (centres - radii[..., None]).amin(dim=(0, 1)).numpy() - 0.15
    high = (centres + radii[..., None]).amax(dim=(0, 1)).numpy() + 0.15
    field = _field(centres, radii)
    # The number of vertices goes with the square of the resolution.
    cell = 0.06
    wanted = vertices
    for attempt in range(12):
        positions, faces = surface_nets(field, low, high, cell, relaxations=4 if attempt else 0)
        close = attempt > 0 and abs(len(positions) - wanted) <= 0.02 * wanted
        if close:
            mesh = make_mesh(positions, faces, name="organic")
            if mesh.report.watertight:
                return mesh
        # Two sheets in one cell are not a surface: a slightly different grid parts them.
        cell *= 0.997 if close else (len(positions) / wanted) ** 0.5
    raise RuntimeError(f"no closed surface of {vertices} vertices was found")


def _limbs() -> tuple[Float[Tensor, "limbs beads 3"], Float[Tensor, "limbs beads"]]:
    """Centres and radii of the balls that make up the limbs; the first is the body."""
    t = np.linspace(0, 1, BEADS)
    centres, radii = [], []
    body = np.stack([0.1 * np.sin(4 * t), 0.35 + 0.55 * t, 0.1 * np.cos(5 * t) - 0.1], axis=-1)
    centres.append(body)
    radii.append(0.42 - 0.2 * t + 0.06 * np.sin(9 * t))
    for limb in range(LIMBS):
        turn = 2 * np.pi * limb / LIMBS
        side = 1 if limb % 2 else -1
        # Out from the body, down to the ground or up above it, then a curl that tightens toward the end.
        bend = turn + side * (1.6 * t**1.5 + 0.5)
        reach = 0.25 + 0.95 * np.sin(np.pi * np.minimum(t, 0.62) / 1.24) * (1 + 0.18 * np.cos(2.3 * limb))
        height = 0.5 + (0.95 + 0.25 * np.sin(2.0 * limb)) * t * (1 if limb % 2 else -0.3) + 0.35 * np.sin(np.pi * t)
        curl = 4.6 * np.clip(t - 0.45, 0, None) / 0.55
        coil = 0.34 * np.clip(t - 0.45, 0, None) / 0.55 * (1.25 - 0.75 * t)
        out = reach + coil * np.cos(curl * 1.5) - coil
        rise = height + coil * np.sin(curl * 1.5)
        centres.append(np.stack([out * np.cos(bend), rise, out * np.sin(bend)], axis=-1))
        ridges = 1 + 0.09 * np.sin(2 * np.pi * 13 * t**0.9) * np.clip(4 * t - 0.6, 0, 1)
        radii.append((0.2 * (1 - t) ** 0.7 + 0.035 + 0.05 * np.exp(-(((t - 1) / 0.035) ** 2))) * ridges)
    stacked = np.stack(centres)
    lowest = (stacked[..., 1] - np.stack(radii)).min()
    stacked[..., 1] -= lowest
    return torch.from_numpy(stacked), torch.from_numpy(np.stack(radii))


def _field(centres: Float[Tensor, "limbs beads 3"], radii: Float[Tensor, "limbs beads"]):  # noqa: ANN202
    """Distance to the limbs, blended where they meet, less hollows in the body."""
    blend = 0.045
    hollows = torch.tensor([[0.05, 1.35, 0.0, 0.33], [0.25, 0.75, 0.45, 0.2], [-0.4, 0.62, 0.2, 0.17]], dtype=torch.float64)

    def field(points: Float[Tensor, "P 3"]) -> Float[Tensor, "P"]:
        balls = centres.to(points.dtype).reshape(-1, 3)
        sizes = radii.to(points.dtype)
        pieces = []
        for chunk in points.split(16384):
            gap = torch.cdist(chunk, balls).reshape(len(chunk), *sizes.shape) - sizes
            solid = -blend * torch.logsumexp(-gap.amin(dim=2) / blend, dim=1)
            hollow = torch.cdist(chunk, hollows[:, :3].to(points.dtype)) - hollows[:, 3].to(points.dtype)
            carved = torch.cat([solid[:, None], -hollow], dim=1)
            pieces.append(blend * torch.logsumexp(carved / blend, dim=1))
        return torch.cat(pieces)

    return field
