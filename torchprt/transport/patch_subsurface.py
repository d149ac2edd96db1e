"""Light that diffuses below the relief of a texture patch, and through it if it is thin."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.progress import Silent
from torchprt.scene import Material, Mesh, Points, Subsurface, read_subsurface, tiled
from torchprt.transport.diffuse import unshadowed
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface import Body, diffused
from torchprt.transport.subsurface_faces import over_faces
from torchprt.transport.workers import Threads, torch_on_one_thread

AROUND = 1
"""Tiles on every side that light diffuses from one by one; those beyond count as their mean."""

_NODES = 32


@dataclass(frozen=True)
class Below:
    """What is below a patch: a `medium`, how many `millimetres` a tile is wide, and, in tiles, how thick the patch is
    at its lowest point; None if it is too thick for light to come through."""

    medium: Subsurface
    millimetres: float | int
    thickness: float | int | None

    @property
    def paint(self) -> Material:
        """What the relief looks like from afar: light that is reflected on between its walls meets this."""
        return Material((self.medium.reflectance * self.medium.entering).tolist())


def below(
    medium: Subsurface | str | None, millimetres: float | int | None, thickness: float | int | None
) -> Below | None:
    """What the arguments of a patch say is below it, None for nothing.

    Raises InputError if the text is no medium, or if a length is missing, given without a medium, or not above 0.
    """
    if medium is None:
        for name, value in (("millimetres", millimetres), ("thickness", thickness)):
            if value is not None:
                raise InputError(f"{name} is given without subsurface: give a medium too, as subsurface='marble'")
        return None
    if isinstance(medium, str):
        medium = read_subsurface(medium)
    if millimetres is None:
        raise InputError(
            f"subsurface is {medium.text}, whose coefficients are per mm: say by millimetres how wide a tile is, "
            "10 for a pore of a waffle"
        )
    for name, value in (("millimetres", millimetres), ("thickness", thickness)):
        # Written so that NaN is refused too.
        if value is not None and not 0 < value < math.inf:
            raise InputError(f"{name} is {value:g}: give a number above 0")
    return Below(medium, millimetres, thickness)


def at_vertices(mesh: Mesh) -> Points:
    """The vertices of a patch as receivers of what arrives there."""
    return Points(mesh.positions, mesh.normals, 1.0)


@torch_on_one_thread()
def leaving(
    mesh: Mesh, arriving: Float[Tensor, "C N V"], what: Below, *, tiles: bool, threads: int | None, progress: Any
) -> Float[Tensor, "3 N V"]:
    """Transfer of what leaves the vertices of a patch, given of what arrives there.

    A thin patch has a level back, which gets all light from below its horizon. Of a patch that tiles, light comes by
    way of `AROUND` copies on every side as it does, and from all beyond as if it arrived there evenly.
    Source: Sloan, Luna and Snyder 2005, section 6 (the waffle with subsurface scattering), with the dipole of Jensen,
    Marschner, Levoy and Hanrahan 2001 for its simulation.
    """
    channels, columns, vertices = arriving.shape
    copies = (2 * AROUND + 1) ** 2 if tiles else 1
    front = tiled(mesh, AROUND) if tiles else mesh
    # A column of ones becomes the sum of the weights.
    light = torch.cat([arriving, torch.ones(channels, 1, vertices)], 1).permute(2, 0, 1)
    mean = _mean(mesh, light)
    positions, faces, light = front.positions, front.faces, light.repeat(copies, 1, 1)
    if what.thickness is not None:
        low = float(mesh.positions[:, 2].min()) - what.thickness
        back = torch.cat([positions[:, :2], torch.full_like(positions[:, :1], low)], 1)
        from_below = torch.ones(columns + 1)
        from_below[:-1] = unshadowed(torch.tensor([[0.0, 0.0, -1.0]]), math.isqrt(columns))[:, 0]
        mean = mean + from_below
        faces = torch.cat([faces, faces.flip(1) + len(positions)])
        light = torch.cat([light, from_below.expand(len(positions), channels, -1)])
        positions = torch.cat([positions, back])
    source, entering = what.medium.dipole, what.medium.entering
    body = Body(torch.arange(len(positions)), positions * what.millimetres, faces, source, entering, asked=vertices)
    with Threads(threads or os.cpu_count() or 1) as runner:
        report = Silent() if isinstance(progress, bool) else progress
        found = diffused(body, light.flatten(1).contiguous(), channels, Stages(runner, report))
    left = found.view(vertices, 3, columns + 1)
    if tiles:
        beyond = (source.total - _over_square(mesh.positions[:, :2], what)).clamp(min=0).float()
        left = left + entering * beyond[..., None] * mean
        left = left / (left[..., -1:] / entering).clamp(min=1)
    return left[..., :-1].permute(1, 2, 0).contiguous()


def _over_square(places: Float64[Tensor, "V 2"], what: Below) -> Float64[Tensor, "V C"]:
    """The integral of the dipole over the square of all tiles that are there, were they level, from places in it."""
    low, high = -float(AROUND), 1.0 + AROUND
    corners = torch.tensor([[low, low, 0], [high, low, 0], [high, high, 0], [low, high, 0]], dtype=torch.float64)
    points = torch.cat([places, torch.zeros_like(places[:, :1])], 1).T * what.millimetres
    found = torch.zeros(len(places), 3, dtype=torch.float64)
    for three in ([0, 1, 2], [0, 2, 3]):
        face = (corners[three] * what.millimetres)[:, :, None].expand(-1, -1, len(places))
        found += over_faces(points.contiguous(), face.contiguous(), what.medium.dipole, _NODES).sum(1).T
    return found


def _mean(mesh: Mesh, values: Float[Tensor, "V C W"]) -> Float[Tensor, "C W"]:
    """What all of a tile gets, over the area of the square below it."""
    corners = mesh.positions[mesh.faces]
    area = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=-1) / 2
    weight: Float64[Tensor, "V"] = torch.zeros(len(values), dtype=torch.float64)
    weight.index_add_(0, mesh.faces.flatten(), (area / 3).repeat_interleave(3))
    return torch.tensordot(weight.to(values.dtype), values, 1)
