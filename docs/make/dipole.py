"""Prints how far the dipole is from a path tracer: needs Mitsuba.

    python docs/make/dipole.py

Balls of one medium in several sizes under a positive light of order 3: how bright they are, their contrast, and the RMS
error of radiance over its mean.
"""

from __future__ import annotations

import sys
from pathlib import Path

import mitsuba as mi
import torch
from rich.console import Console
from trimesh.creation import icosphere

from torchprt.measure import Table
from torchprt.scene import MATERIALS, Material, Object, Scene, make_mesh
from torchprt.shade import shader
from torchprt.transport import bake

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from path_tracer import leaving_ball, positive_light, variant

MEDIUM, POINTS, PATHS, RADII = "skin1", 24, 24_000, (2.0, 4.0, 8.0, 16.0, 32.0)


def main() -> None:
    if fault := variant(mi):
        sys.exit(fault)
    points = torch.tensor(icosphere(4).vertices)
    mesh = make_mesh(points, torch.tensor(icosphere(4).faces), normals=points, name="ball")
    rows = torch.randperm(len(points), generator=torch.Generator().manual_seed(1))[:POINTS]
    light, medium = positive_light(3)[:, 0], MATERIALS[MEDIUM]

    def ours(**material) -> torch.Tensor:
        baked = bake(Scene([Object(mesh, Material(**material))]), shadows=False, order=3, progress=False)
        return shader(baked)(light.float()[:, None].expand(-1, 3))[rows].double().T

    plain = ours(albedo=1.0)[0]
    plain = plain / plain.mean()
    table = Table(f"balls of {MEDIUM}, dipole against volpath")
    for radius in RADII:
        for colour, (name, found) in enumerate(
            zip(("red", "green", "blue"), ours(subsurface=medium, millimetres=radius), strict=True)
        ):
            theirs = leaving_ball(mi, light, radius, medium, colour, points[rows], PATHS)
            level = float(found.mean() / theirs.mean())
            shape, wanted = found / found.mean(), theirs / theirs.mean()
            errors = [float((each - wanted).square().mean().sqrt()) for each in (shape, plain)]
            contrast = [float(each.std()) for each in (shape, wanted, plain)]
            table.add(
                f"{radius:g} mm, {name}",
                extra={
                    "brightness, ours over theirs": f"{level:.2f}",
                    "contrast: ours, theirs, plain": ", ".join(f"{each:.3f}" for each in contrast),
                    "error of the shape: ours, plain": ", ".join(f"{each:.3f}" for each in errors),
                },
            )
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
