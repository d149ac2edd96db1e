"""How much quicker is a bake than the script that Python users have, at equal error?

    python scripts/benchmarks/prt_util.py

The script that came with PIFu (Saito et al. 2019), told here in our own words: uniform random directions over the
whole sphere, one set for all vertices; every vertex asks trimesh (with embreex below it) whether each of them is
blocked, also those below its horizon; a coefficient is the mean of what is seen times cosine and scipy's harmonics.

Errors are RMS relative to the transfer, at a sample of the vertices, against a bake with many rays. That of the script
falls with the root of its directions: how many it would need for the error of a bake is extrapolated, and so is their
time, from directions that were run. What its offset of a thousandth of the extent adds does not fall: only the part
that falls is extrapolated, in favour of the script.
"""

import math
import time
from collections.abc import Callable

import numpy as np
import rich
import torch
import trimesh
from bake import scene_to_measure
from scipy.special import sph_harm_y

from torchprt.measure import Table, relative_rms
from torchprt.scene import Points, Scene
from torchprt.sh import basis
from torchprt.transport import bake

ORDERS, RAYS = (3, 5), (256, 1024)
SAMPLE, REFERENCE_RAYS, SETS = 192, 1 << 16, 8
SIDES, TIMED_SIDE = (10, 20, 40), 5
"""Directions are a square of them, as in the script, whose own choice is 40."""


def harmonics(directions: np.ndarray, order: int) -> np.ndarray:
    """Real harmonics [D, N] from scipy's complex ones, one degree and order a call."""
    polar, azimuth = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    columns = []
    for degree in range(order):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), polar, azimuth)
            part = value.real if m >= 0 else value.imag
            columns.append(part * (math.sqrt(2) if m else 1.0))
    return np.stack(columns, axis=1)


def by_script(mesh: trimesh.Trimesh, points: np.ndarray, normals: np.ndarray, side: int, order: int, seed: int):
    """Coefficients [V, N] of `points`, from side x side directions: a row of the square at a time."""
    random = np.random.default_rng(seed)
    height, turn = 1 - 2 * random.random(side**2), 2 * np.pi * random.random(side**2)
    across = np.sqrt(1 - height**2)
    directions = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    values = harmonics(directions, order)
    starts = np.repeat(points + 1e-3 * mesh.bounding_box.extents.min() * normals, side, axis=0)
    upward = np.repeat(normals, side, axis=0)
    total = np.zeros((len(points), order**2))
    for row in range(side):
        some = slice(row * side, (row + 1) * side)
        rays = np.tile(directions[some], (len(points), 1))
        cosine = np.einsum("ij,ij->i", rays, upward)
        seen = (cosine > 0) & ~mesh.ray.intersects_any(starts, rays)
        weighted = (seen * cosine)[:, None] * np.tile(values[some], (len(points), 1))
        total += weighted.reshape(len(points), side, -1).sum(axis=1)
    return total * (4 / side**2)


def seconds(task: Callable[[], object]) -> tuple[float, float]:
    """Wall and CPU seconds of a task."""
    wall, cpu = time.perf_counter(), time.process_time()
    task()
    return time.perf_counter() - wall, time.process_time() - cpu


def compare(scene: Scene, order: int) -> Table:
    """The table of one order."""
    mesh = scene.objects[0].mesh
    points, normals = mesh.positions.numpy(), mesh.normals.numpy()
    model = trimesh.Trimesh(points, mesh.faces.numpy(), process=False)
    rows = np.random.default_rng(0).permutation(len(points))[:SAMPLE]
    some = Points(mesh.positions[rows], mesh.normals[rows])

    def baked(rays: int, seed: int = 0) -> torch.Tensor:
        found = bake(scene, order=order, rays=rays, seed=seed, receivers=some, progress=False)
        return found.layers["diffuse"].signal.values[0].mT.double()

    check = np.random.default_rng(1).normal(size=(50, 3))
    check /= np.linalg.norm(check, axis=1, keepdims=True)
    ours = basis(torch.from_numpy(check), order).mT.numpy()
    np.testing.assert_allclose(harmonics(check, order).T, ours, atol=1e-10)
    reference = baked(REFERENCE_RAYS, seed=1)
    table = Table(f"order {order}: {len(points)} vertices, error at {SAMPLE} of them")
    squares: dict[int, float] = {}
    for side in SIDES:
        found = [torch.from_numpy(by_script(model, points[rows], normals[rows], side, order, s)) for s in range(SETS)]
        squares[side] = sum(relative_rms(each, reference) ** 2 for each in found) / SETS
        table.add(f"prt_util, {side**2} directions", error=math.sqrt(squares[side]))
    few, many = SIDES[0], SIDES[-1]
    # Error squared is a share over the number of directions, and what stays.
    share = (squares[few] - squares[many]) / (1 / few**2 - 1 / many**2)
    by_script(model, points[:100], normals[:100], 2, order, 0)
    wall, cpu = (
        each / TIMED_SIDE**2 for each in seconds(lambda: by_script(model, points, normals, TIMED_SIDE, order, 0))
    )
    for rays in RAYS:
        error = relative_rms(baked(rays), reference)
        own_wall, own_cpu = seconds(lambda rays=rays: bake(scene, order=order, rays=rays, progress=False))
        needed = share / error**2
        table.add(
            f"bake, {rays} rays",
            error=error,
            seconds=own_wall,
            extra={
                "directions for it (extrapolated)": round(needed),
                "times quicker, wall": needed * wall / own_wall,
                "CPU": needed * cpu / own_cpu,
                "rays a second, ratio (wall)": rays / own_wall * wall,
            },
        )
    stays = math.sqrt(max(squares[many] - share / many**2, 0.0))
    rich.print(
        f"order {order}: prt_util takes {wall:.3f} s a direction ({cpu:.3f} s CPU); {stays:.2%} of its error stays"
    )
    return table


def run() -> None:
    """Prints a table an order."""
    scene = scene_to_measure()
    for order in ORDERS:
        rich.print(compare(scene, order))


if __name__ == "__main__":
    run()
