"""A million vertices from file to file: time and memory by part, and what lies on disk.

    python scripts/benchmarks/million.py [VERTICES [RAYS [BOUNCES]]]     1000000 1024 2 if nothing is given

The ground of `memory.py` is written as .ply, read, baked at order 5 and saved. Memory is that of the process, looked at
ten times a second: "anonymous" is what the process asked for itself, "all" counts mapped files in memory too.
"""

import sys
import tempfile
import threading
import time
from pathlib import Path

import rich
import trimesh
from memory import ORDER, rolling_ground
from rich.console import Console

from torchprt.measure import Table
from torchprt.scene import load, read_mesh
from torchprt.transfer import save
from torchprt.transport import bake


def memory() -> tuple[int, int]:
    """Anonymous and all resident bytes of this process."""
    found = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return 1024 * int(found["RssAnon"].split()[0]), 1024 * int(found["VmRSS"].split()[0])


class Parts:
    """A report of progress that writes down what every part took, with the largest of memory and disk seen in it."""

    def __init__(self, disk: Path) -> None:
        self.parts: list[tuple[str, float, float, int, int, int]] = []
        self._disk, self._stage = disk, ""
        self._over = threading.Event()
        self._begin()
        self._watch = threading.Thread(target=self._look, daemon=True)
        self._watch.start()

    def _begin(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()
        self._most = (0, 0, 0)

    def _look(self) -> None:
        while not self._over.wait(0.1):
            self._see()

    def _see(self) -> None:
        kept = 0
        for each in self._disk.rglob("*"):
            try:
                kept += each.stat().st_size
            except OSError:  # Files of a bake come and go.
                continue
        now = (*memory(), kept)
        self._most = tuple(map(max, self._most, now))  # type: ignore[assignment]

    def start(self, stage: str, total: int = 0, done: int = 0) -> None:
        self.end()
        self._stage = stage

    def advance(self, count: int) -> None: ...

    def end(self) -> None:
        """What was since the last part began belongs to it; between the stages of a bake it has no name."""
        self._see()
        wall, cpu = time.perf_counter() - self._wall, time.process_time() - self._cpu
        self.parts.append((self._stage or "between", wall, cpu, *self._most))
        self._stage = ""
        self._begin()

    def close(self) -> None:
        """Looks no more."""
        self.end()
        self._over.set()
        self._watch.join()


def run(vertices: int = 1_000_000, rays: int = 1024, bounces: int = 2) -> None:
    """Prints one table."""
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        disk = Path(folder)
        made = rolling_ground(vertices)
        path = disk / "ground.ply"
        trimesh.Trimesh(made.positions.numpy(), made.faces.numpy(), process=False).export(path)
        del made
        parts = Parts(disk)
        parts.start("read and check")
        mesh = read_mesh(path)
        parts.end()
        transfer = bake(
            load(mesh), order=ORDER, rays=rays, bounces=bounces, checkpoint=disk / "checkpoint", progress=parts
        )
        parts.start("write")
        save(transfer, disk / "ground.safetensors")
        parts.close()
        written = (disk / "ground.safetensors").stat().st_size
    table = Table(f"{transfer.vertices} vertices, order {ORDER}, {rays} rays, {bounces} bounces")
    for name, wall, cpu, anonymous, everything, kept in parts.parts:
        if wall > 0.05:
            sizes = {"anonymous MiB": anonymous, "all MiB": everything, "disk MiB": kept}
            extra = {"CPU s": round(cpu, 1)} | {each: round(size / 2**20) for each, size in sizes.items()}
            table.add(name, seconds=wall, extra=extra)
    Console(width=None if sys.stdout.isatty() else 120).print(table)
    rich.print(f"the file: {written / 2**20:.0f} MiB")


if __name__ == "__main__":
    run(*map(int, sys.argv[1:]))
