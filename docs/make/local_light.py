"""The pictures and the tables of docs/local-light.md.

python docs/make/local_light.py [picture] [convergence]
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from torch import Tensor
from trimesh.creation import icosphere

from torchprt import light, preview
from torchprt.light import SphereEmitter, incident, local_light, with_sample_points
from torchprt.preview.lobe import sphere
from torchprt.scene import Material, Mesh, Object, Scene, make_mesh, samples
from torchprt.scene.samples.closed import closed_mesh
from torchprt.shade import Shader, local_light_shader, shader, under_field
from torchprt.transfer import Transfer
from torchprt.transport import bake

FOLDER = Path(__file__).parents[1] / "images"
WARM, COOL = "#d1495b", "#30638e"


def rope() -> Mesh:
    """Two beaded strands that wind about each other."""
    turns = torch.linspace(-1, 1, 400)
    thick = 0.17 + 0.04 * (24 * turns).cos() - 0.05 * turns**4
    strands = []
    for phase in (0.0, math.pi):
        angle, radius = 3.5 * math.pi * turns + phase, 0.2 + 0.05 * (3 * turns).cos()
        strands.append(torch.stack([2.1 * turns, radius * angle.cos(), radius * angle.sin()], -1))
    centres, radii = torch.cat(strands), torch.cat([thick, thick])

    def field(points: Tensor) -> Tensor:
        return torch.cat([(torch.cdist(part, centres) - radii).amin(1) for part in points.split(1 << 14)])

    return closed_mesh(field, np.array([-2.5, -0.6, -0.6]), np.array([2.5, 0.6, 0.6]), 20_000, "rope")


def lamps() -> list[SphereEmitter]:
    """Warm and cool at the ends, a white one in the middle, from above and below."""
    return [
        SphereEmitter((-2.15, 0.62, 0.5), 0.13, (34.0, 11.0, 2.2)),
        SphereEmitter((2.15, 0.6, 0.5), 0.13, (2.0, 9.0, 34.0)),
        SphereEmitter((0.0, -0.72, 0.55), 0.12, (13.0, 26.0, 12.0)),
    ]


def exact(transfer: Transfer, module: Shader, shining: Sequence[light.Emitter], sky: Tensor | None = None) -> Tensor:
    """Radiance under a light a vertex."""
    with torch.no_grad():
        field = incident(shining, transfer.positions.double(), transfer.order).float()
        return under_field(module, field if sky is None else field + sky)


def blended(
    transfer: Transfer,
    module: Shader,
    shining: Sequence[light.Emitter],
    count: int,
    gradients: bool,
    sky: Tensor | None = None,
) -> Tensor:
    located = with_sample_points(transfer, count, gradients=gradients)
    with torch.no_grad():
        return local_light_shader(module, located)(local_light(located, shining, environment=sky))


def relative(found: Tensor, wanted: Tensor) -> float:
    return float((found - wanted).double().square().mean().sqrt() / wanted.double().square().mean().sqrt())


def picture() -> None:
    """A rope between coloured lamps: one light for all of it, sample points, and a light a vertex."""
    transfer = bake(Scene([Object(rope(), Material(0.75))]), order=6, rays=1024, bounces=1, progress=False)
    module, shining = shader(transfer), lamps()
    sky = light.hemisphere((0.0, 1.0, 0.0), (0.1, 0.11, 0.14), (0.05, 0.04, 0.04), transfer.order)
    wanted = exact(transfer, module, shining, sky)
    size = (1000, 330)
    centres = torch.stack([lamp.center.double() for lamp in shining])
    shown_at = torch.cat([transfer.positions.double(), centres, centres * torch.tensor([1.0, 1.25, 1.0])])
    camera = preview.frame(shown_at, (0.0, 0.3, 1.0), aspect=size[0] / size[1], field=12.0)
    pieces = [(transfer.positions.double(), transfer.faces.long())]
    glow = []
    for lamp in shining:
        places, faces = sphere(24)
        pieces.append((float(lamp.radius) * places.double() + lamp.center.double(), faces.long()))
        glow.append(lamp.radiance.float().expand(len(places), 3) / 12)
    shift, corners = 0, []
    for places, faces in pieces:
        corners.append(faces + shift)
        shift += len(places)
    still = preview.Still(
        torch.cat([places for places, _ in pieces]), torch.cat(corners), size=size, camera=camera, samples=16
    )
    exposure = -math.log2(0.6 * float(wanted.quantile(0.995)) / 0.6)
    shown, labels = [], []
    for count, gradients, words in (
        (1, False, "one sample in the middle"),
        (8, False, "8 sample points"),
        (16, True, "16 with gradients"),
        (None, False, "a light a vertex"),
    ):
        radiance = wanted if count is None else blended(transfer, module, shining, count, gradients, sky)
        error = "" if count is None else f": error {relative(radiance, wanted):.1%}"
        shown.append(still.picture(torch.cat([radiance.clamp(min=0), *glow]), exposure=exposure))
        labels.append(words + error)
        print(labels[-1])
    preview.save_png(preview.sheet(shown, labels, columns=1), FOLDER / "local-light.png")


def scenes() -> dict[str, Scene]:
    ball = icosphere(subdivisions=4)
    return {
        "sphere": Scene([Object(make_mesh(torch.tensor(ball.vertices), torch.tensor(ball.faces)), Material(0.7))]),
        "sculpture": samples.organic(9_000),
    }


def around(positions: Tensor, gap: float, size: float) -> list[SphereEmitter]:
    """Lamps of `size` radii of the object, with `gap` radii between each and the nearest vertex."""
    middle = (positions.amax(0) + positions.amin(0)) / 2
    radius = float((positions - middle).norm(dim=1).max())
    found = []
    for way in ((0.3, 0.8, 0.5), (-0.6, 0.3, 0.75), (0.9, 0.1, -0.4)):
        unit = torch.nn.functional.normalize(torch.tensor(way, dtype=torch.float64), dim=0)
        near, far = 0.0, 6 * radius
        for _ in range(40):
            along = (near + far) / 2
            inside = float((positions - middle - along * unit).norm(dim=1).min()) < (gap + size) * radius
            near, far = (along, far) if inside else (near, along)
        found.append(SphereEmitter(middle + far * unit, size * radius, (3.0, 3.0, 3.0)))
    return found


def convergence() -> None:
    """Error of the blend against the number of points, relative to a light a vertex: figure 5 of 2002 in numbers."""
    counts = [1, 2, 4, 8, 16, 32, 64]
    figure, axes = plt.subplots(1, 2, figsize=(9.2, 3.4), sharey=True, layout="constrained")
    for axis, (name, scene) in zip(axes, scenes().items(), strict=True):
        transfer = bake(scene, order=5, rays=512, bounces=0, progress=False)
        module = shader(transfer)
        shining = around(transfer.positions.double(), 1.0, 0.25)
        wanted = [exact(transfer, module, [lamp]) for lamp in shining]

        def error(shade: Callable[[SphereEmitter], Tensor], wanted=wanted, shining=shining) -> float:  # type: ignore[no-untyped-def]
            found = [relative(shade(lamp), each) for lamp, each in zip(shining, wanted, strict=True)]
            return sum(found) / len(found)

        for gradients, colour, label in ((False, COOL, "lights alone"), (True, WARM, "with gradients")):
            errors = [
                error(lambda lamp, n=n, g=gradients: blended(transfer, module, [lamp], n, g))  # noqa: B023
                for n in counts
            ]
            axis.plot(counts, errors, "o-", color=colour, label=label, markersize=4)
            print(name, label, " ".join(f"{each:.3f}" for each in errors))
        axis.set(xscale="log", yscale="log", title=name, xlabel="sample points")
        axis.set_xticks(counts, map(str, counts))
        axis.minorticks_off()
        axis.grid(alpha=0.3)
        axis.legend(frameon=False)
    axes[0].set_ylabel("relative RMS error of radiance")
    axes[0].set_yticks([0.01, 0.03, 0.1, 0.3, 1.0], ["1 %", "3 %", "10 %", "30 %", "100 %"])
    figure.savefig(FOLDER / "local-light-convergence.png", dpi=110)


if __name__ == "__main__":
    torch.set_num_threads(1)
    parts = {"picture": picture, "convergence": convergence}
    for name in sys.argv[1:] or parts:
        parts[name]()
