"""How well, and how fast, do zonal lobes stand for transfer? Beside SciPy, and between vertices.

    python scripts/benchmarks/lobes.py

Order 6, shadowed, of the bunny (TORCHPRT_DATA names the folder with mesh/bunny.ply) or, without it, of the project's
own sculpture. Seconds are those of one core. SciPy refines axes and coefficients of one vertex by BFGS from the greedy
start of the paper (Sloan, Luna and Snyder 2005, section 4.1).
"""

import time
import warnings

import numpy as np
import rich
import torch
from bake import scene_to_measure
from scipy.optimize import minimize

from torchprt.compression import Lobes, fit_lobes, lobe_coefficients
from torchprt.compression.lobes import edges_of
from torchprt.compression.single_lobe import hemicube
from torchprt.measure import Table
from torchprt.sh import zonal
from torchprt.transport import bake

ORDER, RAYS, SAMPLE = 6, 1024, 12
PUBLISHED = {1: 0.264, 2: 0.123, 3: 0.045, 4: 0.016}


def relative(error: torch.Tensor, vectors: torch.Tensor) -> float:
    return float((error.double().sum() / vectors.double().square().sum()).sqrt())


def midpoints(lobes: Lobes, vectors: torch.Tensor, edges: torch.Tensor) -> tuple[float, float]:
    """Relative RMS at the middle of edges, from interpolated lobes and from interpolated vectors of SH coefficients."""
    one, other = edges.T
    true = (vectors[one] + vectors[other]) / 2
    parts = [(part[..., one] + part[..., other]) / 2 for part in (lobes.axis, lobes.coefficients, lobes.exact)]
    axis = torch.nn.functional.normalize(parts[0], dim=1)
    between = Lobes(axis, parts[1], parts[2], lobes.error.new_zeros(len(edges))).reconstruct()
    whole = lobes.reconstruct()
    apart = (whole[one] + whole[other]) / 2
    return tuple(relative((found - true).square(), true) for found in (between, apart))  # type: ignore[return-value]


def timed(vectors: torch.Tensor, lobes: int, **options: object) -> tuple[Lobes, float]:
    start = time.process_time()
    return fit_lobes(vectors, lobes, **options), time.process_time() - start  # type: ignore[arg-type]


def fits(vectors: torch.Tensor, faces: torch.Tensor) -> Table:
    edges = edges_of(faces)
    edges = edges[edges[:, 0] < edges[:, 1]]
    table = Table(f"{len(vectors)} vectors of order {ORDER}; errors are relative RMS, those of the paper of its model")
    cases = [(lobes, None) for lobes in PUBLISHED] + [(lobes, 0.03) for lobes in PUBLISHED]
    for lobes, smoothness in [*cases, (4, 0.3), (4, 0.003)]:
        options = {} if smoothness is None else {"smooth": True, "smoothness": smoothness}
        made, seconds = timed(vectors, lobes, faces=faces, **options)
        between, apart = midpoints(made, vectors, edges)
        name = f"{lobes} lobes" + ("" if smoothness is None else f", smooth {smoothness}")
        columns: dict[str, float | str] = {"paper": PUBLISHED[lobes] if smoothness is None else ""}
        columns |= {"midpoints": between, "of SH": apart, "times": between / apart}
        table.add(name, error=relative(made.error, vectors), seconds=seconds, extra=columns)
    return table


def by_scipy(vector: np.ndarray, lobes: int) -> float:
    """The squared error that BFGS over all axes and coefficients leaves, from a greedy start."""
    truth, rest = torch.from_numpy(vector), torch.from_numpy(vector)
    table, start = hemicube(), []
    for _ in range(lobes):
        tried = zonal(lobe_coefficients(rest.expand(len(table), -1), table), table)
        axis = table[(rest - tried).square().sum(1).argmin()]
        coefficients = lobe_coefficients(rest, axis)
        start.append(torch.cat([axis, coefficients]))
        rest = rest - zonal(coefficients, axis)

    def error_and_slope(flat: np.ndarray) -> tuple[float, np.ndarray]:
        free = torch.tensor(flat, requires_grad=True)
        each = free.view(lobes, 3 + ORDER)
        axes = torch.nn.functional.normalize(each[:, :3], dim=1)
        error = (zonal(each[:, 3:], axes).sum(0) - truth).square().sum()
        error.backward()
        return error.item(), free.grad.numpy()  # type: ignore[union-attr]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return float(minimize(error_and_slope, torch.cat(start).numpy(), jac=True, method="BFGS").fun)


def beside_scipy(vectors: torch.Tensor, faces: torch.Tensor, lobes: int = 4) -> Table:
    """Every vertex by torchprt; a few of them, evenly chosen, by SciPy."""
    alone, quick = timed(vectors, lobes)
    made, seconds = timed(vectors, lobes, faces=faces)
    chosen = torch.linspace(0, len(vectors) - 1, SAMPLE).long()
    start = time.process_time()
    squared = torch.tensor([by_scipy(vectors[v, 0].double().numpy(), lobes) for v in chosen])
    theirs = (time.process_time() - start) / len(chosen)
    table = Table(f"{lobes} lobes beside SciPy's BFGS, {len(chosen)} vertices of {len(vectors)}, relative RMS of these")
    table.add("SciPy", error=relative(squared, vectors[chosen]), seconds=theirs, extra={"times": 1.0})
    for name, found, taken in (("every vertex alone", alone, quick), ("with neighbours", made, seconds)):
        ours = taken / len(vectors)
        error = relative(found.error[chosen], vectors[chosen])
        table.add(name, error=error, seconds=ours, extra={"times": theirs / ours})
    return table


def run() -> None:
    """Bakes, fits, and prints the tables."""
    transfer = bake(scene_to_measure(), order=ORDER, rays=RAYS, progress=False)
    torch.set_num_threads(1)
    vectors = transfer.layers["diffuse"].signal.values.permute(2, 0, 1)
    for make in (fits, beside_scipy):
        rich.print(make(vectors, transfer.faces))


if __name__ == "__main__":
    run()
