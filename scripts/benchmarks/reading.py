"""How long a mesh of a million vertices takes to be read and checked, beside what trimesh takes to parse the same file.

    python scripts/benchmarks/reading.py [VERTICES [ROUNDS [SUFFIX ...]]]

The ground of `memory.py` in each format, from a file that the system holds in memory. "memory": the most that a process
of its own had while it read, beyond what it had before, in bytes a vertex.
"""

import multiprocessing
import statistics
import sys
import tempfile
import time
from pathlib import Path

import trimesh
from memory import rolling_ground

from torchprt.scene import read_mesh

SUFFIXES = (".ply", ".glb", ".stl", ".obj", ".off")


def peak() -> int:
    """Bytes that this process has had at most."""
    found = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return 1024 * int(found["VmHWM"].split()[0])


def once(path: Path) -> tuple[float, int, int]:
    """Seconds, bytes and vertices of one reading; for a process of its own."""
    # What is loaded to read at all.
    tiny = trimesh.creation.box()
    with tempfile.TemporaryDirectory() as folder:
        tiny.export(Path(folder) / f"box{path.suffix}")
        read_mesh(Path(folder) / f"box{path.suffix}")
    before, start = peak(), time.perf_counter()
    mesh = read_mesh(path)
    return time.perf_counter() - start, peak() - before, len(mesh.positions)


def parsed(path: Path) -> float:
    """Seconds of trimesh alone."""
    start = time.perf_counter()
    trimesh.load(path, process=False, force="mesh")
    return time.perf_counter() - start


def run(vertices: int = 1_000_000, rounds: int = 5, *suffixes: str) -> None:
    """Prints one table."""
    made = rolling_ground(vertices)
    whole = trimesh.Trimesh(made.positions.numpy(), made.faces.numpy(), process=False)
    print(f"{len(whole.vertices)} vertices, {len(whole.faces)} faces, {rounds} rounds, median and range")
    print("| file | MB | read and checked, s | trimesh alone, s | ratio | bytes a vertex |\n|---|---|---|---|---|---|")
    with (
        tempfile.TemporaryDirectory() as name,
        multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool,
    ):
        for suffix in suffixes or SUFFIXES:
            path = Path(name) / f"ground{suffix}"
            whole.export(path)
            found = [(*pool.apply(once, (path,)), parsed(path)) for _ in range(rounds)]
            ours, bare = [each[0] for each in found], [each[3] for each in found]
            ratio = statistics.median(mine / theirs for mine, theirs in zip(ours, bare, strict=True))
            size = statistics.median(each[1] for each in found) / found[0][2]
            shown = " | ".join(f"{statistics.median(e):.2f} ({min(e):.2f} to {max(e):.2f})" for e in (ours, bare))
            print(f"| `{suffix}` | {path.stat().st_size / 1e6:.0f} | {shown} | {ratio:.2f} | {size:.0f} |", flush=True)
            path.unlink()


if __name__ == "__main__":
    run(*map(int, sys.argv[1:3]), *sys.argv[3:])
