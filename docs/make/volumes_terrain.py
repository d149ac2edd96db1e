"""Writes docs/images/volume-terrain.png: a cloud whose shadow goes over land as the sun goes around.

python docs/make/volumes_terrain.py
"""

from __future__ import annotations

import time
from pathlib import Path

from torchprt import demo, preview

FOLDER = Path(__file__).parents[1] / "images"


def main() -> None:
    demo.SIZE, demo.CLOUD, demo.LAND = (460, 400), 48, 144
    start = time.process_time()
    cloud, land = demo.clouded()
    print(f"{cloud}\n{land}\n{time.process_time() - start:.0f} s of CPU")
    preview.save_png(demo.under_cloud(cloud, land), FOLDER / "volume-terrain.png")


if __name__ == "__main__":
    main()
