"""Writes the picture of docs/texels.md, and prints how far both sides of seams are apart.

python docs/make/texels.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from torchprt import preview
from torchprt.scene import Lightmap, samples
from torchprt.scene.seams import LEVELS, seams
from torchprt.shade import shader
from torchprt.transfer import Atlas, bilinear
from torchprt.transport import bake

FOLDER = Path(__file__).parents[1] / "images"
TEXELS, SIZE = 192, (1100, 1100)
CROP = slice(330, 730), slice(330, 730)


def across_seams(atlas: Atlas, values: Tensor) -> tuple[Tensor, Tensor]:
    """Values at points along all seams, read from the one side and from the other."""
    faces, uv = atlas.mesh_faces.long().numpy(), atlas.mesh_uv.double().numpy()
    normals = atlas.mesh_normals.double().numpy()[faces]
    found = seams(atlas.mesh_positions.double().numpy(), faces, normals, uv, 1e-9)
    # The first triangles hold the whole edges, from their first corners to their second.
    count = len(found.face) // (4 * LEVELS)
    share = np.linspace(0.1, 0.9, 9)[:, None, None]
    image = atlas.image(values)
    ends = ((each[:count, 0], each[:count, 1]) for each in (found.uv, found.place))
    one, other = (torch.from_numpy((1 - share) * a + share * b).float().flatten(0, 1) for a, b in ends)
    return bilinear(image, one), bilinear(image, other)


def nearest(atlas: Atlas) -> Atlas:
    """Gutters that show the nearest texel of the chart, as usual."""
    number = np.full(atlas.rows * atlas.columns, -1)
    number[atlas.texel.numpy()] = np.arange(atlas.count)
    number = number.reshape(atlas.rows, atlas.columns)
    _, near = distance_transform_edt(number < 0, return_indices=True)
    cell = atlas.gutter.long().numpy()
    sources = torch.from_numpy(number[near[0].ravel()[cell], near[1].ravel()[cell]]).int()
    weights = torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(len(cell), 4).contiguous()
    return atlas.replace(gutter_sources=sources[:, None].expand(-1, 4).contiguous(), gutter_weights=weights)


def main() -> None:
    torch.set_num_threads(1)
    scene = samples.head(12_000)
    baked = bake(scene, lightmap=Lightmap(TEXELS, uv="unwrap"), rays=1024, bounces="auto", progress=False)
    atlas = baked.receivers.as_atlas()
    print(f"{baked}, {int(atlas.chart.max()) + 1} charts, {TEXELS} x {TEXELS}")
    none = torch.zeros(0, 4)
    without = atlas.replace(gutter=none[:, 0].int(), gutter_sources=none.int(), gutter_weights=none)
    under = preview.built_in_environment("studio", baked.order)
    camera = preview.frame(baked.receivers.subject, (0.5, 0.25, 1.0))
    still = preview.Still.of(atlas, size=SIZE, camera=camera, samples=9)
    exposure = preview.automatic_exposure(under.light)
    pictures = []
    for name, place in (("no gutters", without), ("nearest texel", nearest(atlas)), ("beyond the seam", atlas)):
        radiance = shader(baked)(under.light)
        one, other = across_seams(place, radiance)
        print(f"{name}: both sides of seams are apart by {float((one - other).norm() / other.norm()):.2%} (RMS)")
        still = preview.Still.of(place, size=SIZE, camera=camera, samples=9)
        pictures.append(still.picture(radiance, exposure=exposure)[CROP])
    names = ["no gutters", "nearest texel of the chart", "the surface beyond the seam"]
    preview.save_png(preview.sheet(pictures, names, columns=3), FOLDER / "texels.png")


if __name__ == "__main__":
    main()
