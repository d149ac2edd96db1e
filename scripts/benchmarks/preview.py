"""What does a frame of the window cost, drawing apart, and a still without one?

    python scripts/benchmarks/preview.py [BAKE.safetensors ...]

A diffuse sculpture of 35 000 vertices at order 5, or the given bakes. Process CPU time on one thread. "light" and
"camera": a drag of either by a degree and the new colours, as the session makes them; "to Open3D": the colours handed
over and marked as changed, where Open3D is installed and there is a display. Drawing itself is up to the graphics card.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rich
import torch

from torchprt import light, load_transfer, preview
from torchprt.errors import InputError
from torchprt.measure import Table, time_it
from torchprt.preview.drawing import Drawing
from torchprt.scene import samples
from torchprt.shade import shader
from torchprt.transfer import Transfer
from torchprt.transport import bake

VERTICES, ORDER, RAYS = 35_000, 5, 64
MOST_SHADE, MOST_STILL = 5e-3, 2.0
DEGREE = math.radians(1)


def studio_for(transfer: Transfer) -> preview.Environment:
    image = light.studio(256)
    return preview.Environment("studio", light.project(image, transfer.order), image)


def session_of(name: str, transfer: Transfer) -> preview.Session:
    return preview.Session({name: transfer}, [studio_for(transfer)])


def window_for(session: preview.Session) -> Drawing | None:
    """What Open3D draws of the session, in a window that nobody sees; None where there can be none."""
    try:
        open3d = preview.check_window()
    except InputError as fault:
        rich.print(f"without Open3D: {fault}")
        return None
    viewer = open3d.visualization.VisualizerWithKeyCallback()
    viewer.create_window("benchmark", 800, 600, visible=False)
    return Drawing(open3d, viewer, session)


def frame_costs(session: preview.Session) -> dict[str, Callable[[], Any]]:
    """The parts of a frame, by name."""

    def turned(turn: Callable[[float, float], None]) -> Callable[[], Any]:
        def once() -> None:
            turn(DEGREE, 0.0)
            session.colours()

        return once

    costs = {"light": turned(session.turn_light), "camera": turned(session.turn_camera), "nothing": session.colours}
    drawing = window_for(session)
    if drawing is not None:
        costs["to Open3D"] = lambda: drawing.send(session.colours())
    return costs


def still_seconds(transfer: Transfer) -> float:
    """CPU time of a still of 800 x 600, shading and rays."""
    environment = studio_for(transfer)
    start = time.process_time()
    studio = preview.Studio(transfer, shader(transfer), environment)
    studio.picture(preview.frame(transfer.positions), torch.eye(3))
    return time.process_time() - start


def run(paths: list[str] | None = None, rounds: int = 9) -> None:
    """Prints the costs in milliseconds, and which targets are kept."""
    torch.set_num_threads(1)
    bakes: dict[str, Transfer] = {Path(path).stem: load_transfer(path) for path in paths or []}
    if not bakes:
        bakes["sculpture"] = bake(samples.organic(VERTICES), order=ORDER, rays=RAYS, progress=False)
    table = Table("milliseconds of CPU a frame")
    for name, transfer in bakes.items():
        times = time_it(frame_costs(session_of(name, transfer)), rounds=rounds)
        parts = {part: f"{1e3 * timing.median:.2f}" for part, timing in times.items()}
        table.add(name, bytes=transfer.bytes, extra={"kind": transfer.kind, "vertices": transfer.vertices, **parts})
        total = times["light"].median + (times["to Open3D"].median if "to Open3D" in times else 0.0)
        still = still_seconds(transfer)
        rich.print(
            f"{name}: light to screen {1e3 * total:.2f} ms (target {1e3 * MOST_SHADE:.0f}); still {still:.2f} s "
            f"(target {MOST_STILL:.0f})"
        )
    rich.print(table)


if __name__ == "__main__":
    run(sys.argv[1:])
