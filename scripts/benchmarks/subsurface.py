"""How fast light diffuses over a scan, by clusters and face by face, and how far the two are apart.

    python scripts/benchmarks/subsurface.py [MESH]

Face by face: one block of receivers in sixteen, of all faces; what is near is integrated over in both.
"""

from __future__ import annotations

import sys
import time
import warnings
from pathlib import Path

import torch

from torchprt.progress import Silent
from torchprt.scene import MATERIALS, read_mesh, samples
from torchprt.transport.diffuse import unshadowed
from torchprt.transport.stages import Stages
from torchprt.transport.subsurface import Body, Gathering, Paths, diffused, entering_items, paths_of, tasks_of
from torchprt.transport.workers import Threads

HEIGHT = 150.0
"""Of the model, in mm."""
ONE_IN = 16


def run(path: Path | None = None) -> None:
    """Prints a line a medium."""
    torch.set_num_threads(1)
    warnings.simplefilter("ignore")
    mesh = samples.head(35_000).objects[0].mesh if path is None else read_mesh(path)
    places = mesh.positions - mesh.positions.mean(0)
    places = places * (HEIGHT / float(places[:, 1].amax() - places[:, 1].amin()))
    arriving = unshadowed(mesh.normals, 5).T.float().contiguous()
    for name in ("marble", "skin1"):
        medium = MATERIALS[name]
        body = Body(torch.arange(len(places)), places, mesh.faces, medium.dipole, medium.entering)
        with Threads(1) as workers:
            stages = Stages(workers, Silent())
            start = time.process_time()
            paths = body.once("paths", lambda body=body, stages=stages: paths_of(body, stages))
            prepared = time.process_time() - start
            start = time.process_time()
            found = diffused(body, arriving, 1, stages)
            gathered = time.process_time() - start
        everything = torch.arange(paths.tree.clusters, len(paths.tree.centre))
        all_faces = Paths(paths.tree, paths.blocks, paths.own, [everything] * len(paths.items), paths.near)
        light = torch.cat([arriving, torch.ones(len(places), 1)], 1)
        values = entering_items(body, paths.tree, light)[None]
        times, square, total = {"all": 0.0, "clusters": 0.0}, 0.0, 0.0
        for task in tasks_of(paths.blocks, Gathering)[::ONE_IN]:
            start = time.process_time()
            exact = task.compute(body, all_faces, values)["leaving"]
            middle = time.process_time()
            fast = task.compute(body, paths, values)["leaving"]
            times["all"] += middle - start
            times["clusters"] += time.process_time() - middle
            mine = paths.own[task.index]
            square += float((exact - fast)[mine][..., :-1].double().square().sum())
            leaving = found.view(len(places), 3, -1)[paths.blocks[task.index][mine]] / medium.entering
            total += float(leaving.double().square().sum())
        items = sum(map(len, paths.items)) / len(paths.items)
        whole = times["all"] * ONE_IN
        print(
            f"{mesh.name}, {len(places)} vertices, {name}: edge {float(body.size.median()):.2f} mm, paths "
            f"{prepared:.1f} s, gather {gathered:.1f} s ({items:.0f} items a block, of {len(everything)} faces); face "
            f"by face {whole:.0f} s ({times['all'] / times['clusters']:.0f} times), with what is near "
            f"{(whole + prepared) / (gathered + prepared):.0f} times; apart {(square / total) ** 0.5:.1e} (RMS)"
        )


if __name__ == "__main__":
    run(*map(Path, sys.argv[1:2]))
