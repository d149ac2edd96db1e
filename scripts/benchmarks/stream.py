"""What does it cost to find clusters in a sample of receivers, and to keep a transfer on disk?

    python scripts/benchmarks/stream.py [PART ...]      # sample large

`sample`: the bunny (or the project's sculpture), against clusters of all receivers: the ratio of squared errors.
`large`: a file of a few gigabytes (GIGABYTES, 2 if not given) is written, read and compressed, each in a process of its
own: time, and the most anonymous memory, which is what the process has for itself; pages of a mapped file are not.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import torch
from compress import diffuse, glossy, stored
from rich.console import Console

from torchprt.compression import compress
from torchprt.measure import Table
from torchprt.transfer import diffuse_transfer, load, save

SHARES = (1 / 2, 1 / 4, 1 / 8)
ORDER, PIECE = 5, 1 << 16


def sample() -> Iterator[Table]:
    """Squared error and time, as parts of those of a fit to all receivers."""
    cases = {
        "diffuse": (diffuse, ({"clusters": 64}, {"clusters": 256}, {"clusters": 256, "method": "adaptive"})),
        "glossy": (glossy, ({"clusters": 64}, {"clusters": 256, "shared": 160, "bits": 8})),
    }
    for kind, (make, chosen) in cases.items():
        transfer = make()
        table = Table(f"clusters of a sample, {kind}: {transfer.vertices} receivers")
        for options in chosen:
            name = ", ".join(f"{key} {value}" for key, value in options.items())
            start = time.process_time()
            whole = stored(compress(transfer, **options))  # type: ignore[arg-type]
            seconds = time.process_time() - start
            table.add(name, error=whole.compression_error, bytes=whole.bytes, extra={"CPU s": f"{seconds:.1f}"})
            for share in SHARES:
                start = time.process_time()
                some = stored(compress(transfer, sample=int(share * transfer.vertices), **options))  # type: ignore[arg-type]
                extra = {"CPU s": f"{time.process_time() - start:.1f}"}
                extra |= {"receivers a cluster": f"{share * transfer.vertices / options['clusters']:.0f}"}
                extra |= {"squared error / all": f"{(some.compression_error / whole.compression_error) ** 2:.3f}"}
                table.add(
                    f"{name}; 1 / {1 / share:.0f} of them", error=some.compression_error, bytes=some.bytes, extra=extra
                )
        yield table


def anonymous() -> int:
    """Bytes of memory that the process has for itself now; Linux tells."""
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("Anonymous:"))


class Watched:
    """Time of a block, and the most anonymous memory in it above what there was before."""

    def __enter__(self) -> Watched:
        self._before, self._most, self._over = anonymous(), 0, threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._start = time.perf_counter()
        self._thread.start()
        return self

    def _watch(self) -> None:
        while not self._over.wait(0.05):
            self._most = max(self._most, anonymous())

    def __exit__(self, *_: object) -> None:
        self.seconds = time.perf_counter() - self._start
        self._over.set()
        self._thread.join()
        self.bytes = max(self._most, anonymous()) - self._before


def step(name: str, path: Path, receivers: int) -> None:
    """One of the steps of `large`, which says what it took."""
    torch.set_num_threads(1)
    if name == "write":
        # Smooth over the receivers, as transfer is, with noise as of rays.
        angle = torch.linspace(0, 200, receivers)
        values = torch.empty(1, ORDER**2, receivers)
        generator = torch.Generator().manual_seed(0)
        for row in range(ORDER**2):
            values[0, row] = (angle * (row + 1)).sin() / (row + 1)
            values[0, row] += 0.003 * torch.randn(receivers, generator=generator)
        places = torch.stack([angle, angle.sin(), angle.cos()], 1)
        made = diffuse_transfer(values, torch.full((1, 1), 0.5), places, places, torch.zeros(0, 3, dtype=torch.int32))
        with Watched() as watched:
            save(made, path)
        found = {}
    else:
        with Watched() as watched:
            transfer = load(path, mapped=name != "copied")
            found = {}
            if name == "compressed":
                packed = compress(transfer, clusters=64, components=4, bits=8, sample=1 << 16)
                found = {"error": stored(packed).compression_error, "bytes": packed.bytes}
    print(json.dumps({"seconds": watched.seconds, "memory": watched.bytes} | found))


def large() -> Iterator[Table]:
    """A transfer that stays on disk."""
    size = float(os.environ.get("GIGABYTES", "2"))
    receivers = int(size * 2**30 / (4 * ORDER**2)) // PIECE * PIECE
    table = Table(f"{receivers / 1e6:.1f} million receivers of order {ORDER}, {size:g} GB")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "large.safetensors"
        for name in ("write", "copied", "mapped", "compressed"):
            command = [sys.executable, __file__, "--step", name, str(path), str(receivers)]
            done = subprocess.run(command, check=True, capture_output=True, text=True, env=os.environ)
            found = json.loads(done.stdout)
            extra = {"s": f"{found['seconds']:.1f}", "anonymous memory, MB": f"{found['memory'] / 2**20:.0f}"}
            table.add(name, error=found.get("error"), bytes=found.get("bytes"), extra=extra)
    yield table


PARTS = {"sample": sample, "large": large}


def run(names: list[str] | None = None) -> None:
    """Prints the tables of all parts, or of some."""
    torch.set_num_threads(1)
    console = Console(width=None if sys.stdout.isatty() else 150)
    for name in names or PARTS:
        for table in PARTS[name]():
            console.print(table)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--step"]:
        step(sys.argv[2], Path(sys.argv[3]), int(sys.argv[4]))
    elif unknown := sorted(set(sys.argv[1:]) - set(PARTS)):
        sys.exit(f"there is no part {unknown[0]}: choose from {' '.join(PARTS)}")
    else:
        run(sys.argv[1:])
