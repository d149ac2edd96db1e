"""How long a bake at texels takes beside one at as many vertices, where its time goes, and what memory it takes.

    python scripts/benchmarks/texels.py [MESH] [TEXELS]

The vertices are those of the same mesh with its faces divided until there are as many or more; their time is scaled to
as many receivers. 256 rays, shadows alone, every core. Rounds take turns; a ratio is that of one round.
"""

from __future__ import annotations

import resource
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh

from torchprt.scene import Lightmap, Object, Scene, make_mesh, read_mesh, samples
from torchprt.scene.pack import pack
from torchprt.scene.unwrap import unwrap
from torchprt.transfer import Transfer
from torchprt.transport import bake

ROUNDS, RAYS = 3, 256


def run(path: Path | None = None, size: str = "1024") -> None:
    """Prints time, ratio and memory."""
    warnings.simplefilter("ignore")
    mesh = samples.head(35_000).objects[0].mesh if path is None else read_mesh(path)
    scene, lightmap = Scene([Object(mesh)]), Lightmap(int(size), uv="unwrap")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    texels, first = _timed(lambda: bake(scene, lightmap=lightmap, rays=RAYS, progress=False))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    atlas = texels.receivers.as_atlas()
    finer = _divided(scene, texels.vertices)
    rounds = []
    for number in range(ROUNDS):
        one = first if number == 0 else _timed(lambda: bake(scene, lightmap=lightmap, rays=RAYS, progress=False))[1]
        vertices, other = _timed(lambda: bake(finer, rays=RAYS, progress=False))
        rounds.append((one, other * texels.vertices / vertices.vertices))
    charts, made = _timed(lambda: unwrap(mesh.positions.numpy(), mesh.faces.numpy(), mesh.name))
    _, packed = _timed(lambda: pack([charts], lightmap.rows, lightmap.columns, lightmap.gutter))
    ratios = np.array([one / other for one, other in rounds])
    one, other = np.median(np.array(rounds), axis=0)
    print(
        f"{mesh.name}, {size} x {size}: {texels.vertices} texels of {len(mesh.positions)} vertices, "
        f"{texels.vertices / (atlas.rows * atlas.columns):.0%} of the map; {one:.1f} s, as many vertices "
        f"{other:.1f} s: {np.median(ratios):.2f} times ({ratios.min():.2f} to {ratios.max():.2f})"
    )
    print(f"of that xatlas {made:.1f} s for charts, {packed:.1f} s to pack them")
    shares = (
        f"{side}: {_area(pack([charts], side, side, lightmap.gutter)[0]):.0%}" for side in (256, 1024, 2048, 4096)
    )
    print(f"area of the charts on square maps, {', '.join(shares)}")
    kept = sum(each.numel() * each.element_size() for each in atlas.tensors().values())
    print(
        f"memory {peak / 2**10:.0f} MB at most, {peak * 1024 / texels.vertices:.0f} bytes a texel; the file "
        f"{texels.bytes / 2**20:.0f} MB of transfer, {kept / 2**20:.0f} MB of the map; error "
        f"{texels.error / texels.signal:.2%}"
    )


def _timed(make: Callable[[], Transfer]) -> tuple[Transfer, float]:
    start = time.perf_counter()
    return make(), time.perf_counter() - start


def _area(uv: np.ndarray) -> float:
    one, other = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    return float(np.nansum(np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])) / 2)


def _divided(scene: Scene, wanted: int) -> Scene:
    mesh = scene.objects[0].mesh
    places, faces = mesh.positions.numpy(), mesh.faces.numpy()
    while len(places) < wanted:
        places, faces = trimesh.remesh.subdivide(places, faces)
    return Scene([Object(make_mesh(places, faces, name="divided"))])


if __name__ == "__main__":
    torch.set_num_threads(1)
    run(*(make(each) for make, each in zip((Path, str), sys.argv[1:3], strict=False)))
