"""The picture of docs/adaptive.md: at which order receivers stand, and what that loses.

python docs/make/adaptive.py
"""

from __future__ import annotations

import warnings
from pathlib import Path

import torch

from torchprt import light, preview, sh
from torchprt.scene import Material, Object, Scene, samples
from torchprt.shade import adaptive, display, shader
from torchprt.shade.white import white
from torchprt.transport import OrderWarning, bake

FOLDER = Path(__file__).parents[1] / "images"
ORDER, SIZE = 11, (380, 400)
# Linear RGB of orders 3 to 11 as they grow: grey, blue, green, yellow, red.
COLOURS = {5: (0.45, 0.47, 0.5), 7: (0.1, 0.3, 0.62), 9: (0.85, 0.62, 0.08), 11: (0.72, 0.08, 0.1)}
MOST = 0.03


def regions() -> torch.Tensor:
    """A sculpture shaded whole, adaptively, the orders of its receivers in colour, and the error."""
    mesh = samples.organic(30_000).objects[0].mesh
    scene = Scene([Object(mesh, Material(0.4, gloss="phong:20", specular=0.6))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OrderWarning)
        transfer = bake(scene, order=ORDER, frame="visibility", visibility_order=ORDER, rays=1024, progress=False)
    lamp = sh.least_window(light.project(light.studio(256), ORDER).float())[0]
    camera = preview.frame(transfer.positions, (0.35, 0.45, 1.0), aspect=SIZE[0] / SIZE[1])
    still = preview.Still(transfer.positions, transfer.faces, size=SIZE, camera=camera, samples=9)
    module, eye = shader(transfer), torch.tensor(camera.eye, dtype=torch.float32)
    with torch.no_grad():
        whole = module(lamp, eye=eye)
        found, seen = adaptive(module, transfer.faces)(lamp, eye=eye)
    exposure = preview.automatic_exposure(lamp)
    error = (found - whole).abs().amax(-1) / float(white(lamp))
    orders = seen.orders["visibility"]
    shade = 0.35 + 0.65 * transfer.normals[:, 1:2].clamp(min=0).float()
    paint = torch.zeros(len(orders), 3)
    for order, colour in COLOURS.items():
        paint[orders == order] = torch.tensor(colour)
    pictures = [
        still.picture(whole, exposure=exposure),
        still.picture(found, exposure=exposure),
        still.picture(paint * shade, tone="none"),
        still.radiance(preview.error_colours(error, MOST), background=display(still.plain(), tone="none")),
    ]
    parts = [f"{order}: {100 * float((orders == order).float().mean()):.0f} %" for order in COLOURS]
    labels = [f"order {ORDER}", "adaptive", f"orders {', '.join(parts)}", f"error, red at {MOST:g} of white"]
    return preview.sheet(pictures, labels, columns=4)


if __name__ == "__main__":
    torch.set_num_threads(1)
    preview.save_png(regions(), FOLDER / "adaptive.png")
