"""Basis, rotation and projection beside sphericart and e3nn: CPU time and error, measured in the same run."""

import math
import statistics
import time
import warnings
from collections.abc import Callable

import torch
from rich.console import Console
from rich.table import Table

from torchprt import sh

ROUNDS = 15
FILLED_MS = 20.0


def interleaved(tasks: dict[str, Callable[[], object]]) -> dict[str, list[float]]:
    """Process CPU milliseconds of every task, in turns, so that a busy machine slows all of them alike.

    A measurement is the mean of as many runs in a row as fill `FILLED_MS`, after one that is not measured: what
    the task before left in the caches is not the fault of this one.
    """
    times: dict[str, list[float]] = {name: [] for name in tasks}
    repeats = dict.fromkeys(tasks, 1)
    for _ in range(1 + ROUNDS):
        for name, task in tasks.items():
            task()
            start = time.process_time()
            for _ in range(repeats[name]):
                task()
            times[name].append(1e3 * (time.process_time() - start) / repeats[name])
            repeats[name] = max(1, math.ceil(FILLED_MS / max(times[name][0], 1e-3)))
    # The first round only told how many runs fill a measurement.
    return {name: measured[1:] for name, measured in times.items()}


def table(title: str, tasks: dict[str, Callable[[], object]], errors: dict[str, float]) -> Table:
    """One row a task: median, spread and the ratio to the first task."""
    times = interleaved(tasks)
    ours = statistics.median(next(iter(times.values())))
    result = Table("", "median ms", "quartiles", "of ours", "error", title=title)
    for name, row in times.items():
        low, middle, high = statistics.quantiles(row, n=4)
        error = f"{errors[name]:.1e}" if name in errors else ""
        result.add_row(name, f"{middle:.3f}", f"{low:.3f} - {high:.3f}", f"{middle / ours:.2f} x", error)
    return result


def basis_of_many_directions(count: int, order: int) -> list[Table]:
    import sphericart.torch
    from e3nn import o3

    directions, _ = sh.fibonacci(count, torch.float32)
    leaf = directions.clone().requires_grad_()
    calculator, degrees = sphericart.torch.SphericalHarmonics(order - 1), list(range(order))

    def backward(evaluate: Callable[[torch.Tensor], torch.Tensor]) -> torch.Tensor:
        (gradient,) = torch.autograd.grad(evaluate(leaf).sum(), leaf)
        return gradient

    forms: dict[str, Callable[[torch.Tensor], torch.Tensor]] = {
        "torchprt": lambda d: sh.basis(d, order),
        "sphericart": lambda d: calculator.compute(d),
        "e3nn": lambda d: o3.spherical_harmonics(degrees, d, normalize=False, normalization="integral"),
    }
    signs = sh.to_sign_free(torch.ones(order**2, 1, dtype=torch.float64))[:, 0]
    axes = {"torchprt": (directions.double(), torch.ones_like(signs)), "sphericart": (directions.double(), signs)}
    axes["e3nn"] = (directions.double()[:, [2, 0, 1]], signs)
    errors = {
        name: (form(directions).double() - sh.basis(axes[name][0], order) * axes[name][1]).abs().max().item()
        for name, form in forms.items()
    }
    return [
        table(
            f"basis, order {order}, {count} directions, float32",
            {name: lambda f=form: f(directions) for name, form in forms.items()},
            errors,
        ),
        table(
            f"the same with its gradient, {count} directions",
            {name: lambda f=form: backward(f) for name, form in forms.items()},
            {},
        ),
    ]


def rotation_of_many_lights(count: int, order: int) -> list[Table]:
    from e3nn import o3

    generator = torch.Generator().manual_seed(0)
    rotation = sh.yaw_pitch_roll(360 * torch.rand(count, 3, generator=generator))
    light = torch.randn(count, order**2, 3, generator=generator)
    exact = sh.rotation_matrix(rotation.double(), order)
    turned = exact @ light.double()
    converted = sh.to_e3nn(light)

    def wigner() -> list[torch.Tensor]:
        angles = o3.matrix_to_angles(rotation)
        return [o3.wigner_D(l, *angles) for l in range(order)]

    def by_wigner() -> torch.Tensor:
        blocks = [d @ converted[:, l * l : (l + 1) ** 2] for l, d in enumerate(wigner())]
        return torch.cat(blocks, -2)

    return [
        table(
            f"rotation of {count} lights of order {order}, float32",
            {
                "torchprt": lambda: sh.rotate(light, rotation),
                "torchprt, matrices": lambda: sh.rotation_matrix(rotation, order) @ light,
                "e3nn": by_wigner,
            },
            {
                "torchprt": (sh.rotate(light, rotation) - turned).abs().max().item(),
                "torchprt, matrices": (sh.rotation_matrix(rotation, order) @ light - turned).abs().max().item(),
                "e3nn": (sh.from_e3nn(by_wigner()) - turned).abs().max().item(),
            },
        ),
        table(
            f"matrices of the bands, {count} rotations, order {order}",
            {"torchprt": lambda: sh.rotation_bands(rotation, order), "e3nn": wigner},
            {"torchprt": (sh.rotation_matrix(rotation, order) - exact).abs().max().item()},
        ),
    ]


def projection_of_images(order: int) -> list[Table]:
    generator = torch.Generator().manual_seed(0)
    cube = torch.rand(6, 64, 64, 3, generator=generator)
    image = torch.rand(512, 1024, 3, generator=generator)
    small = torch.rand(64, 128, 3, generator=generator)
    dense = sh.latlong_basis(order, 64, 128)
    return [
        table(
            f"projection to order {order}",
            {
                "cube map 6 x 64 x 64": lambda: sh.project_cube(cube, order),
                "lat-long 64 x 128": lambda: sh.project_latlong(small, order),
                "lat-long 64 x 128, table": lambda: dense @ small.flatten(0, 1),
                "lat-long 512 x 1024": lambda: sh.project_latlong(image, order),
            },
            {},
        )
    ]


def run() -> None:
    """Prints every table. One thread; needs sphericart-torch and e3nn (`pip install torchprt[peers]`)."""
    torch.set_num_threads(1)
    console = Console()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for count in (10_000, 100_000):
            for result in basis_of_many_directions(count, 6):
                console.print(result)
        for result in (*rotation_of_many_lights(1000, 6), *projection_of_images(5)):
            console.print(result)


if __name__ == "__main__":
    run()
