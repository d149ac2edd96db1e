"""Writes the pictures of docs/subsurface.md.

    python docs/make/subsurface.py [NAME ...]

All of them without a name: "heads", "thin_and_thick".
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path

import torch
from PIL import Image

from torchprt import light, preview
from torchprt.scene import Material, Mesh, Object, Scene, make_mesh, samples
from torchprt.shade import shader
from torchprt.transfer import Transfer
from torchprt.transport import bake

FOLDER = Path(__file__).parents[1] / "images"
ORDER = 6
JADE = "subsurface:0.5,0.7,0.55,0.02,0.004,0.015,1.5"
MILLIMETRES = 25.0
"""A unit of the head, which is 2.1 tall: a figure of 53 mm."""


def behind(side: float = 0.75) -> torch.Tensor:
    """A bright disc behind to the right and a little of everything."""
    lamp = light.disc((side, 0.35, -0.7), math.radians(25), 1.0, order=ORDER, normalise=True)
    return (lamp + light.constant(0.06, order=ORDER)).float()


def baked(mesh: Mesh, rays: int = 512, **material) -> Transfer:
    start = time.process_time()
    found = bake(Scene([Object(mesh, Material(**material))]), order=ORDER, rays=rays, progress=False)
    print(f"{found}, {time.process_time() - start:.0f} s of CPU")
    return found


def picture(transfer: Transfer, view, size: tuple[int, int], lit: torch.Tensor, exposure: float) -> torch.Tensor:
    camera = preview.frame(transfer.positions, view, aspect=size[0] / size[1])
    still = preview.Still(transfer.positions, transfer.faces, size=size, camera=camera, samples=9)
    return still.picture(shader(transfer)(lit).detach(), exposure=exposure)


def heads() -> None:
    """Plain diffuse, and three media, lit from before and from behind."""
    mesh = samples.head().objects[0].mesh
    lamp = light.disc((-0.7, 0.6, 0.7), math.radians(25), 1.0, order=ORDER, normalise=True)
    front = (lamp + light.constant(0.1, order=ORDER)).float()
    media = {"marble": "marble", "skin": "skin1", "jade": JADE}
    pictures: list[list[torch.Tensor]] = [[], []]
    for name in ("diffuse", *media):
        inside = {"subsurface": media[name], "millimetres": MILLIMETRES} if name in media else {"albedo": 0.6}
        transfer = baked(mesh, **inside)
        for row, (lit, exposure) in enumerate(((front, 0.3), (behind(), 1.3))):
            pictures[row].append(picture(transfer, (0.25, 0.05, 1.0), (300, 380), lit, exposure))
    labels = [f"{name}, {where}" for where in ("from before", "from behind") for name in ("diffuse", *media)]
    save(preview.sheet([*pictures[0], *pictures[1]], labels, columns=4), "subsurface_heads.png")


def leaf(thick: float, count: int = 64) -> Mesh:
    """A curved leaf: a sheet of no thickness, or a body of `thick` in the middle that ends in a rim."""
    u = torch.linspace(0, 1, count, dtype=torch.float64)
    v = torch.linspace(-1, 1, count // 2 + 1, dtype=torch.float64)
    u, v = torch.meshgrid(u, v, indexing="ij")
    width = 0.42 * torch.sin(math.pi * u.clamp(0.004, 0.996) ** 0.8)
    rise = 0.16 * torch.sin(math.pi * u) + 0.1 * width * v**2
    # A rib along the middle.
    swell = thick / 2 * (1 - v**2).clamp(min=0).sqrt() * torch.sin(math.pi * u).clamp(min=0).sqrt()
    swell = swell * (0.45 + 0.55 * torch.exp(-((v / 0.12) ** 2)))
    sides = [torch.stack([v * width, 2 * u - 1, rise + sign * swell], -1).view(-1, 3) for sign in (1, -1)]
    index = torch.arange(u.numel()).view(u.shape)
    a, b, c, d = (each.flatten() for each in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    front = torch.cat([torch.stack([a, b, c], -1), torch.stack([a, c, d], -1)])
    if not thick:
        return make_mesh(sides[0], front, name="leaf")
    # The rim is of both sides.
    rim = ((v.abs() == 1) | (u == 0) | (u == 1)).flatten()
    fresh = torch.cumsum(~rim, 0) - 1 + u.numel()
    back = torch.where(rim, index.flatten(), fresh)[front.flip(1)]
    return make_mesh(torch.cat([sides[0], sides[1][~rim]]), torch.cat([front, back]), name="leaf")


def thin_and_thick() -> None:
    """A membrane and diffusion, each on a leaf and on a head, lit from behind."""
    green = (0.35, 0.55, 0.12)
    medium = "subsurface:1.2,1.6,0.9,0.1,0.02,0.4,1.4"
    head = samples.head().objects[0].mesh
    found, labels = [], []
    for mesh, body, view, exposure, name in (
        (leaf(0.0), leaf(0.1), (0.3, 0.2, 1.0), 0.3, "leaf"),
        (head, head, (0.25, 0.05, 1.0), 1.2, "head"),
    ):
        ways = {
            "diffuse": (mesh, {"albedo": green}),
            "membrane": (mesh, {"albedo": green, "translucency": 0.8}),
            "diffusion": (body, {"subsurface": medium, "millimetres": 20.0}),
        }
        for way, (shape, material) in ways.items():
            found.append(picture(baked(shape, **material), view, (300, 360), behind(0.3), exposure))
            labels.append(f"{name}: {way}")
    save(preview.sheet(found, labels, columns=3), "thin_and_thick.png")


def save(picture: torch.Tensor, name: str) -> None:
    values = (picture.clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    Image.fromarray(values).save(FOLDER / name, optimize=True)
    print(f"{name}: {(FOLDER / name).stat().st_size / 1024:.0f} kB")


MADE = {"heads": heads, "thin_and_thick": thin_and_thick}

if __name__ == "__main__":
    for name in sys.argv[1:] or MADE:
        MADE[name]()
