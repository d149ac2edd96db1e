"""The sweep of docs/tradeoff.md: the project's own sculpture, its plot and its error maps.

    python docs/make/tradeoff.py [CACHE]

Times differ from machine to machine, and a little from time to time. `CACHE` keeps what is measured, so that the
picture can be drawn again in seconds.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import torch

from torchprt import light
from torchprt.measure import tradeoff
from torchprt.measure.plot import save_plot
from torchprt.measure.tradeoff_files import thumbnails
from torchprt.preview import save_png
from torchprt.scene import samples

FOLDER = Path(__file__).parents[1] / "images"
VERTICES, ORDER, SHOWN = 30_000, 10, 6


def main(keep: str) -> None:
    scene = samples.organic(VERTICES, albedo=0.6)
    lights = {name: light.project(light.built_in(name), ORDER) for name in ("studio", "sky")}
    found = tradeoff(scene, lights, order=ORDER, keep=keep, name="Sculpture, 30 000 vertices,")
    save_plot(found, FOLDER / "tradeoff.png")
    save_png(thumbnails(found, SHOWN), FOLDER / "tradeoff_errors.png")
    for by in ("seconds", "bytes"):
        for times in (2, 4, 8):
            print(found.halved(by, times))


if __name__ == "__main__":
    torch.set_num_threads(1)
    if len(sys.argv) > 1:
        main(sys.argv[1])
    else:
        with tempfile.TemporaryDirectory() as folder:
            main(folder)
