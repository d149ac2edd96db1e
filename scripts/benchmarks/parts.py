"""What memory a bake takes that is written part by part, beside one whose result is whole in memory.

    python scripts/benchmarks/parts.py [VERTICES]

Coloured rolling ground, order 16 (768 numbers a vertex), few rays, one bounce. Each bake runs in a process of its own.
"private": the most memory that was the process's own (anonymous pages, every 20 ms) beyond what it was before the bake;
pages of mapped files are not, which the system drops when others need room.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import torch
from memory import rolling_ground
from rich.console import Console

from torchprt.measure import Table
from torchprt.scene import load
from torchprt.transfer import save
from torchprt.transport import bake

VERTICES, ORDER, RAYS = 100_000, 16, 16


class Private:
    """The most private memory of this process while a block runs, beyond what it was before."""

    def __enter__(self) -> Private:
        self._before, self.most = self._now(), 0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    @staticmethod
    def _now() -> int:
        for line in Path("/proc/self/smaps_rollup").read_text().splitlines():
            if line.startswith("Anonymous:"):
                return 1024 * int(line.split()[1])
        raise RuntimeError("this benchmark needs /proc, which Linux has")

    def _watch(self) -> None:
        while not self._done.wait(0.02):
            self.most = max(self.most, self._now() - self._before)


def one(how: str, vertices: int) -> dict[str, float | str]:
    """One bake in this process, "whole" or in "parts"."""
    scene = load(rolling_ground(vertices), albedo=(0.6, 0.5, 0.4))
    folder = Path(tempfile.mkdtemp(dir="."))
    try:
        # What torch and Embree load when they are first used.
        bake(load(rolling_ground(1000)), order=ORDER, rays=RAYS, bounces=1, progress=False)
        given = {"order": ORDER, "rays": RAYS, "bounces": 1, "progress": False}
        start = time.perf_counter()
        with Private() as seen:
            if how == "parts":
                bake(scene, out=folder / "a.safetensors", **given)
            else:
                save(bake(scene, **given), folder / "a.safetensors")
        seconds = time.perf_counter() - start
        digest = hashlib.sha256()
        with (folder / "a.safetensors").open("rb") as file:
            while some := file.read(1 << 24):
                digest.update(some)
        size = (folder / "a.safetensors").stat().st_size
    finally:
        shutil.rmtree(folder)
    return {"seconds": seconds, "private": seen.most, "file": size, "digest": digest.hexdigest()}


def run(vertices: int = VERTICES) -> None:
    """Prints memory and time of both, and of one with a limit."""
    table = Table(f"{vertices} vertices, order {ORDER}, three channels, one bounce: MB")
    digests = set()
    for name, how in (("whole", "whole"), ("in parts", "parts")):
        command = [sys.executable, __file__, how, str(vertices)]
        found = json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)
        digests.add(found["digest"])
        sizes = {"file": found["file"] / 2**20, "private": found["private"] / 2**20}
        figures = {column: round(size) for column, size in sizes.items()} | {"seconds": round(found["seconds"], 1)}
        table.add(name, extra=figures)
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    print("the same bytes" if len(digests) == 1 else "NOT the same bytes")


if __name__ == "__main__":
    torch.set_num_threads(1)
    if len(sys.argv) > 2:
        print(json.dumps(one(sys.argv[1], int(sys.argv[2]))))
    else:
        run(*map(int, sys.argv[1:]))
