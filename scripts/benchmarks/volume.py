"""What does a picture of a volume cost, and what is off in each way of reading it?

    python scripts/benchmarks/volume.py [CELLS ...]

The sample of a cloud, 32 and 128 cells a side, of which about a fifth hold anything, in 256 x 256 rays. Process CPU
time on one thread. "shade": a light to the source radiance of the cells. The error of "nearest" is against "exact",
that of "trilinear" against as much with six steps a cell: relative RMS of radiance, of a source that is smooth.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Sequence

import rich
import torch

from torchprt import light
from torchprt.measure import Table, time_it
from torchprt.scene import samples
from torchprt.shade import Composite, Reading, pinhole, shader
from torchprt.transfer import Cells, Dense, Diffuse, Transfer

SIZE, ORDER = 256, 5
# Steps, in those of a ray along the longest side with one a cell.
STEPS: dict[Reading, tuple[float, ...]] = {"nearest": (1.0, 2.0, 4.0), "trilinear": (0.5, 1.0, 2.0)}


def cloud(resolution: int) -> Transfer:
    """Its cells with transfer of random numbers: how fast it is does not depend on them."""
    volume = samples.cloud(resolution)
    held = volume.extinction.flatten().nonzero()[:, 0]
    place = {"shape": volume.shape, "origin": volume.origin, "spacing": volume.spacing}
    cells = Cells(**place, cells=held.int(), extinction=volume.extinction.flatten()[held])
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(1, ORDER**2, cells.count, generator=generator)
    return Transfer(receivers=cells, layers={"diffuse": Diffuse(signal=Dense(values=values), albedo=torch.ones(1, 1))})


def run(resolutions: Sequence[int] = (32, 128)) -> None:
    """Prints the table."""
    torch.set_num_threads(1)
    table = Table(f"a volume in {SIZE} x {SIZE} rays, CPU time on one thread")
    for resolution in resolutions:
        transfer = cloud(resolution)
        cells = transfer.receivers.as_cells()
        shade, lamp = shader(transfer), light.project(light.studio(64), ORDER)
        x, y, z = cells.positions.unbind(-1)
        glow = torch.stack([torch.sin(3 * x) + 1.2, torch.cos(2 * y + 1) + 1.1, z + 1.5], -1)
        eye = 4.2 * torch.nn.functional.normalize(torch.tensor([0.45, 0.35, 1.0]), dim=0)
        rays = pinhole(eye, torch.zeros(3), (SIZE, SIZE)).flatten(0, 1)
        ways: dict[str, Composite] = {"exact": Composite(cells)}
        longest = max(ways["exact"].shape)
        for reading, steps in STEPS.items():
            for each in steps:
                way = Composite(cells, reading=reading, samples=round(each * longest))
                ways[f"{reading}, {way.samples} steps"] = way
        finest = Composite(cells, reading="trilinear", samples=6 * longest)
        with torch.no_grad():
            found = {name: way(glow, eye[None], rays)[0] for name, way in ways.items()}
            wanted = {"nearest": found["exact"], "trilinear": finest(glow, eye[None], rays)[0]}
            calls = {name: functools.partial(way, glow, eye[None], rays) for name, way in ways.items()}
            times = time_it({"shade": functools.partial(shade, lamp)} | calls, rounds=3)
        for name, taken in times.items():
            reference = wanted.get(name.split(",")[0])
            error = None
            if reference is not None:
                error = float((found[name] - reference).square().mean().sqrt() / reference.square().mean().sqrt())
            filled = f"{cells.count / resolution**3:.0%}"
            table.add(f"{resolution}^3, {name}", error=error, seconds=taken, extra={"filled": filled})
    rich.print(table)


if __name__ == "__main__":
    run([int(each) for each in sys.argv[1:]] or (32, 128))
