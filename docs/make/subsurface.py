"""Writes the pictures of docs/subsurface.md.

    python docs/make/subsurface.py [NAME ...]

All of them without a name: "heads", "sizes", "thin", "searchlight".
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from pathlib import Path

import torch
from torch import Tensor

from torchprt import light, preview, sh
from torchprt.progress import Silent
from torchprt.scene import MATERIALS, Material, Mesh, Object, Scene, make_mesh, samples
from torchprt.shade import shader
from torchprt.transfer import Transfer
from torchprt.transport import Threads, bake
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface import Body, diffused

FOLDER = Path(__file__).parents[1] / "images"
SIZE = (300, 340)
ORDER = 6
JADE = "subsurface:0.45,0.75,0.5,0.032,0.0035,0.018,1.6"
# A unit of the head is so many mm: it is a figure 52 mm tall.
FIGURE = 25
VERTICES = 9_000


def baked(mesh: Mesh, material: Material, rays: int = 256) -> Transfer:
    start = time.perf_counter()
    found = bake(Scene([Object(mesh, material)]), order=ORDER, rays=rays, bounces=1, progress=False)
    print(f"{found}, {time.perf_counter() - start:.0f} s")
    return found


def behind(strength: float = 5.0) -> preview.Environment:
    """A lamp behind and above, and a little of a sky."""
    lamp = light.disc(
        (-0.45, 0.5, -1.0), math.radians(14), (strength, 0.96 * strength, 0.9 * strength), ORDER, normalise=True
    )
    light_of = sh.window(lamp, sh.hann(2 * ORDER)[:ORDER]) + light.constant((0.06, 0.07, 0.09), ORDER)
    return preview.Environment("behind", light_of.float())


def picture(transfer: Transfer, environment: preview.Environment, direction: tuple[float, float, float]) -> Tensor:
    studio = preview.Studio(transfer, shader(transfer), environment, size=SIZE, samples=9, exposure=0.0)
    return studio.picture(preview.frame(transfer.positions, direction, aspect=SIZE[0] / SIZE[1]), torch.eye(3))


def heads() -> None:
    """Plain diffuse beside three media, lit from behind."""
    mesh, lit = samples.head(VERTICES).objects[0].mesh, behind()
    marble = MATERIALS["marble"]
    materials = {
        "plain diffuse, as bright as marble": Material((marble.entering * marble.reflectance).float()),
        "marble": Material(subsurface="marble", millimetres=FIGURE),
        "skin1": Material(subsurface="skin1", millimetres=FIGURE),
        "like jade": Material(subsurface=JADE, millimetres=FIGURE),
    }
    pictures = [picture(baked(mesh, each), lit, (0.35, 0.1, 1.0)) for each in materials.values()]
    preview.save_png(preview.sheet(pictures, list(materials), columns=4), FOLDER / "subsurface.png")


def sizes() -> None:
    """One head of skin in three sizes."""
    mesh, lit = samples.head(VERTICES).objects[0].mesh, behind()
    pictures = [
        picture(baked(mesh, Material(subsurface="skin2", millimetres=scale)), lit, (0.35, 0.1, 1.0))
        for scale in (8, 25, 100)
    ]
    captions = [f"{2.06 * scale:.0f} mm tall" for scale in (8, 25, 100)]
    preview.save_png(preview.sheet(pictures, captions, columns=3), FOLDER / "subsurface_sizes.png")


def leaf(thickness: float | None, resolution: int = 40) -> Mesh:
    """A leaf in the plane of x and y: a sheet, or a body of a thickness at its midrib that thins toward the rim."""
    ticks = torch.linspace(-1, 1, resolution, dtype=torch.float64)
    u, v = torch.meshgrid(ticks, ticks, indexing="xy")
    # A disc of squares, drawn out to a leaf.
    x, y = u * torch.sqrt(1 - v**2 / 2), v * torch.sqrt(1 - u**2 / 2)
    width = 0.62 * (1 - 0.35 * y - 0.25 * y**2)
    at = torch.stack([x * width, 1.25 * y, 0.15 * torch.cos(2 * y) - 0.25 * x**2], -1).view(-1, 3)
    index = torch.arange(resolution**2).view(resolution, resolution)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = torch.cat([torch.stack([a, b, c], -1).view(-1, 3), torch.stack([a, c, d], -1).view(-1, 3)])
    if thickness is None:
        return make_mesh(at, faces, name="leaf")
    bulge = (1 - (x**2 + y**2)).clamp(min=0).sqrt().view(-1, 1) * torch.tensor([0.0, 0.0, thickness / 2])
    rim = (index == 0) | False
    rim[0], rim[-1], rim[:, 0], rim[:, -1] = True, True, True, True
    under = torch.where(rim.flatten(), index.flatten(), -1)
    under[~rim.flatten()] = resolution**2 + torch.arange(int((~rim).sum()))
    return make_mesh(
        torch.cat([at + bulge, (at - bulge)[~rim.flatten()]]), torch.cat([faces, under[faces].flip(1)]), name="leaf"
    )


def thin() -> None:
    """What a membrane and what diffusion make of a leaf, and of a body."""
    lit, green = behind(), (0.25, 0.5, 0.1)
    medium = "subsurface:1.6,2.0,1.2,0.12,0.022,0.35,1.4"
    mesh = samples.head(VERTICES).objects[0].mesh
    ball = {"translucency": 0.7}
    made = {
        "leaf, membrane": (leaf(None), Material(green, **ball)),
        "leaf 1.5 mm thick, diffusion": (leaf(0.05), Material(subsurface=medium, millimetres=30)),
        "body, membrane": (mesh, Material(green, **ball)),
        "body 52 mm tall, diffusion": (mesh, Material(subsurface=medium, millimetres=FIGURE)),
    }
    pictures = [picture(baked(*each), lit, (0.35, 0.1, 1.0)) for each in made.values()]
    preview.save_png(preview.sheet(pictures, list(made), columns=4), FOLDER / "subsurface_thin.png")


def searchlight() -> None:
    """What leaves around a lit point, of a fine flat mesh and by the formula."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    resolution, edge = 121, 0.15
    ticks = (torch.arange(resolution, dtype=torch.float64) - resolution // 2) * edge
    x, z = torch.meshgrid(ticks, ticks, indexing="xy")
    index = torch.arange(resolution**2).view(resolution, resolution)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = torch.cat([torch.stack([a, b, c], -1).view(-1, 3), torch.stack([a, c, d], -1).view(-1, 3)])
    places = torch.stack([x, torch.zeros_like(x), -z], -1).view(-1, 3)
    figure, axes = plt.subplots(figsize=(6.4, 3.6))
    lit = torch.zeros(len(places), 1)
    middle = resolution**2 // 2
    lit[middle] = 1
    for name, style in (("marble", "-"), ("skin1", "--")):
        medium = MATERIALS[name]
        body = Body(torch.arange(len(places)), places, faces, medium.dipole, 1.0, spread=0.25)
        with Threads(1) as workers:
            found = diffused(body, lit, 1, Stages(workers, Silent()))
        along = index[resolution // 2, resolution // 2 :]
        far = places[along, 0].double()
        exact = medium.dipole.profile(far)
        for colour, shade in enumerate(("tab:red", "tab:green", "tab:blue")):
            axes.semilogy(
                far, exact[:, colour], style, color=shade, linewidth=1, label=f"{name}" if colour == 0 else None
            )
            axes.semilogy(far, found[along, colour] / edge**2, ".", color=shade, markersize=3)
        error = (found[along] / edge**2 - exact).abs() / exact
        print(f"{name}: {float(error[7:54].max()):.1%} at most from 1 to 8 mm")
    axes.set_xlabel("distance, mm")
    axes.set_ylabel("leaving, per mm²")
    axes.set_ylim(1e-7, 1)
    axes.set_title("A lit point: the formula (lines) and a mesh of 0.15 mm (dots)", fontsize=9)
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(FOLDER / "subsurface_searchlight.png", dpi=110)


PICTURES = {"heads": heads, "sizes": sizes, "thin": thin, "searchlight": searchlight}

if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()
