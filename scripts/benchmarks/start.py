"""How long commands take to start, beside `python -c "import torch"`.

    python scripts/benchmarks/start.py [ROUNDS] [WORD ...]

Every round starts each command once, one after another, in a process of its own, on one thread and on files that are
read already; a ratio is that of one round. WORD: only the commands with one of these in them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

ROUNDS = 9
TARGET = 1.2
TORCH = "import torch"
# What there is to do is small, so that what is left is the start.
COMMANDS = (
    "--help",
    "info a.safetensors",
    "info cube.ply",
    "info light.npy",
    "info sky.exr",
    "info broken.ply",
    "info broken.glb",
    "info foreign.safetensors",
    "bake broken.ply -o b.safetensors",
    "bake broken.glb -o b.safetensors",
    "light studio -o b.npy",
    "light sky.exr -o b.npy",
    "shade a.safetensors -o b.npy",
    "shade a.safetensors --light light.npy -o b.npy",
    "shade a.safetensors -o b.ply",
    "shade a.safetensors -o b.png",
    "bake cube.ply -o b.safetensors",
    "export a.safetensors -o b.onnx",
)


def run(rounds: str = str(ROUNDS), *words: str) -> None:
    """Prints, for each command, time, CPU time of the user, and their ratios to those of `import torch`."""
    chosen = [each for each in COMMANDS if not words or any(word in each for word in words)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files(folder)
        calls = {TORCH: ["-c", TORCH]} | {each: ["-m", "torchprt", "-q", *each.split()] for each in chosen}
        found: dict[str, list[tuple[float, float]]] = {each: [] for each in calls}
        for number in range(int(rounds) + 1):
            for each, call in calls.items():
                seconds = _timed(call, folder)
                if number:
                    found[each].append(seconds)
    torch = np.array(found[TORCH])
    print(f"{TORCH}: {np.median(torch[:, 0]):.2f} s, user {np.median(torch[:, 1]):.2f} s; at most {TARGET} times that")
    print("| command | s | ratio | user s | ratio |\n|---|---|---|---|---|")
    for each in chosen:
        seconds = np.array(found[each])
        shown = " | ".join(f"{np.median(seconds[:, k]):.2f} | {_spread(seconds[:, k] / torch[:, k])}" for k in (0, 1))
        print(f"| `{each}` | {shown} |")


def files(folder: Path) -> None:
    """What the commands are about: small files, some of them no files of theirs."""
    import OpenEXR

    corners, triangles = ("0 0 0", "1 0 0", "0 1 0", "0 0 1"), ("1 3 2", "1 2 4", "1 4 3", "2 3 4")
    head = ["ply", "format ascii 1.0", "element vertex 4", *(f"property float {axis}" for axis in "xyz")]
    head += ["element face 4", "property list uchar int vertex_indices", "end_header"]
    rows = ["3 " + " ".join(str(int(corner) - 1) for corner in each.split()) for each in triangles]
    (folder / "cube.ply").write_text("\n".join([*head, *corners, *rows, ""]))
    (folder / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\n")
    (folder / "broken.glb").write_bytes(b"glTF\2\0\0\0" + bytes(100))
    (folder / "foreign.safetensors").write_bytes(bytes(range(200)))
    np.save(folder / "light.npy", np.eye(9, 3, dtype=np.float32))
    sky = np.linspace(0.1, 1, 16 * 32 * 3, dtype=np.float32).reshape(16, 32, 3)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {"RGB": sky}) as opened:
        opened.write(str(folder / "sky.exr"))
    command = [sys.executable, "-m", "torchprt", "-q", "bake", "cube.ply", "-o", "a.safetensors"]
    subprocess.run([*command, "--order", "3", "--rays", "64"], cwd=folder, check=True)


def _timed(call: Sequence[str], folder: Path) -> tuple[float, float]:
    """Seconds of the wall, and of the user's CPU time, of a process of Python."""
    start = time.perf_counter()
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, *call], cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode not in (0, 2):
        raise SystemExit(f"error: {' '.join(call)} ended with {process.returncode}")
    return wall, used.ru_utime


def _spread(ratios: np.ndarray) -> str:
    low, middle, high = np.quantile(ratios, (0.25, 0.5, 0.75))
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


if __name__ == "__main__":
    run(*sys.argv[1:])
