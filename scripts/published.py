"""Published figures beside ours.

"published" is what the paper prints (or, for the accuracy of basis and rotation, what a good implementation is known
to reach); "recomputed" is an independent evaluation of the paper's definition, not by torchprt; "torchprt" is computed
now. Figures that nobody could reproduce are shown as such.
"""

import math
import sys
from pathlib import Path

import torch
from published_lobes import LOBES
from rich.console import Console

from torchprt import sh
from torchprt.measure import Table

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from numerics.exact import basis_row


def basis_accuracy() -> Table:
    known = {(6, torch.float64): 1.2e-14, (33, torch.float64): 6.6e-14, (65, torch.float64): 3e-13}
    known |= {(6, torch.float32): 6e-7, (33, torch.float32): 1.4e-5}
    spread, _ = sh.fibonacci(12)
    poles = torch.tensor([[0, 0, 1], [0, 0, -1], [1, 0, 0], [1e-9, 0, 1], [1e-4, -2e-4, -1]], dtype=torch.float64)
    directions = torch.cat([spread, torch.nn.functional.normalize(poles, dim=-1)])
    table = Table("basis: largest error against 50 digits, poles included")
    for (order, dtype), published in known.items():
        rounded = directions.to(dtype)
        pairs = zip(rounded.tolist(), sh.basis(rounded, order).tolist(), strict=True)
        worst = max(float(abs(a - b)) for s, row in pairs for a, b in zip(row, basis_row(s, order), strict=True))
        name = f"order {order}, {str(dtype).removeprefix('torch.')}"
        table.add(name, extra={"published": f"{published:.1e}", "torchprt": f"{worst:.1e}"})
    return table


def rotation_accuracy() -> Table:
    order = 6
    generator = torch.Generator().manual_seed(0)
    turns = sh.yaw_pitch_roll(360 * torch.rand(100, 3, generator=generator, dtype=torch.float64))
    # D(R) is the projection of the turned basis: exact quadrature, no algebra of rotations.
    directions, weights = sh.gauss_legendre(2 * (order - 1))
    there = sh.basis((directions @ turns.mT).reshape(-1, 3), order).reshape(len(turns), -1, order**2)
    projected = there.mT @ (sh.basis(directions, order) * weights[:, None])
    # The unit basis vectors as lights: what `rotate` makes of them is the matrix.
    identity = torch.eye(order**2, dtype=torch.float64)
    table = Table(f"rotation, order {order}: largest error of a matrix element, against projecting the turned basis")
    for dtype, published in ((torch.float64, 2e-15), (torch.float32, 2e-7)):
        rounded = turns.to(dtype)
        reference = projected if dtype == torch.float64 else sh.rotation_matrix(rounded.double(), order)
        name = str(dtype).removeprefix("torch.")
        for way, matrix in (
            ("rotation_matrix", sh.rotation_matrix(rounded, order)),
            ("rotate", sh.rotate(identity.to(dtype).expand(len(turns), -1, -1), rounded)),
        ):
            worst = (matrix - reference).abs().max().item()
            known = f"{published:.0e}" if way == "rotation_matrix" else ""
            table.add(f"{way}, {name}", extra={"published": known, "torchprt": f"{worst:.1e}"})
    return table


def mean_and_worst(projection: torch.Tensor) -> str:
    """Squared error in percent of what `projection` does to order-6 signals of unit energy."""
    error = projection - torch.eye(len(projection))
    squared = error.mT @ error
    mean, worst = squared.trace() / len(squared), torch.linalg.eigvalsh(squared)[-1]
    return f"{100 * float(mean):.4f}, {100 * float(worst):.4f}"


def projection_of_texels(size: int, weights: str) -> torch.Tensor:
    table = sh.basis(sh.cube_directions(size).reshape(-1, 3), 6)
    return sh.cube_basis(6, size, weights, torch.float64) @ table  # type: ignore[arg-type]


def projection_of_bilinear(size: int, fine: int = 8) -> torch.Tensor:
    """Signals sampled at texel centres, interpolated bilinearly within the faces, and integrated against the basis.

    One natural reading of "continuous bilinear reconstruction"; the recomputed figures are of another.
    """
    samples = sh.basis(sh.cube_directions(size).reshape(-1, 3), 6).reshape(6, size, size, 36).movedim(-1, 1)
    between = torch.nn.functional.interpolate(samples, scale_factor=fine, mode="bilinear", align_corners=False)
    return sh.cube_basis(6, size * fine, "exact", torch.float64) @ between.movedim(1, -1).reshape(-1, 36)


def cube_maps() -> Table:
    table = Table("cube maps to order 6: squared error in %, mean and worst (Sloan, Kautz and Snyder 2002, 6.2)")

    def add(name: str, published: str, recomputed: str, ours: str, verdict: str = "") -> None:
        columns = {"published": published, "recomputed": recomputed, "torchprt": ours, "": verdict}
        table.add(name, extra=columns)

    texels = {
        "paper": [(4, ".3, 1", ".2652, 1.209"), (8, ".003, .02", ".0032, .0159")],
        "exact": [(4, "", ".2607, .9355"), (8, "", ".0058, .0179")],
        "normalised": [(4, "", ".2347, .8698"), (8, "", ".0018, .0077")],
    }
    names = {"paper": "the paper's weights", "exact": "exact solid angles", "normalised": "weights summing to 4 pi"}
    for weights, rows in texels.items():
        for size, published, recomputed in rows:
            ours = mean_and_worst(projection_of_texels(size, weights))
            add(f"6 x {size} x {size}, {names[weights]}", published, recomputed, ours)
    bilinear = [(8, ".7, 2", ".694, 1.585"), (16, ".2, .5", ".0554, .129"), (32, ".05, .1", ".0047, .0111")]
    for size, published, recomputed in bilinear:
        ours = mean_and_worst(projection_of_bilinear(size))
        add(
            f"6 x {size} x {size}, bilinear",
            published,
            recomputed,
            ours,
            "not reproduced; the paper does not define it",
        )
    return table


def gaunt_counts() -> Table:
    table = Table("non-zeros of the Gaunt tensor")
    for order, known in ((3, 83), (5, 1158), (6, 2907), (11, 65913)):
        count = int(torch.count_nonzero(sh.gaunt(order, order, order)))
        table.add(f"order {order}", extra={"published": known, "torchprt": count})
    return table


def hemisphere() -> Table:
    """Sloan, Hall, Hart and Snyder 2003, section 9: signals of order 5 known above the horizon alone."""
    gram = sh.hemisphere_gram(5)
    values = torch.linalg.svdvals(gram).flip(0)
    table = Table("the hemisphere, order 5, squared error worst and mean")
    singular = f"{values[0]:.4e}, {values[1]:.4e}, {values[-1]:.8f}"
    table.add("singular values", extra={"published": "6.59e-6, 3.10e-4, 1", "torchprt": singular})
    cost = 1 / torch.linalg.inv(gram).diagonal()
    table.add("cost of discarding l=1, m=0", extra={"published": "1.48e-5", "torchprt": f"{cost[2]:.4e}"})
    for name, kind, order, published in (
        ("zero", "zero", 5, ".125, .0402"),
        ("odd reflection, order 8", "odd", 8, ".145, .044"),
        ("even reflection, order 7", "even", 7, ".022, .0036"),
        ("even reflection, order 5", "even", 5, ".193, .030"),
    ):
        worst, mean = sh.hemisphere_error(sh.hemisphere_projection(order, kind), sh.hemisphere_gram(order), order=5)
        table.add(name, extra={"published": published, "torchprt": f"{worst:.5g}, {mean:.5g}"})
    return table


def direction_sets() -> Table:
    """The published signal was a scan's; here 150 cosines, each behind a random cap, of the same RMS, .252."""
    counts = (256, 1024, 4096, 10000)
    known = {
        "uniform random": (8.2e-2, 4.2e-2, 2.1e-2, 1.3e-2),
        "Sobol": (1.6e-2, 4.5e-3, 1.5e-3, 9.8e-4),
        "spherical Fibonacci": (9.7e-3, 3.4e-3, 1.2e-3, 6.2e-4),
    }
    generator = torch.Generator().manual_seed(0)
    draws = torch.randn(2, 150, 3, generator=generator, dtype=torch.float64)
    axes, normals = torch.nn.functional.normalize(draws, dim=-1)
    cosine = 0.3 + 0.7 * torch.rand(150, 1, generator=generator, dtype=torch.float64)

    def project(directions: torch.Tensor) -> torch.Tensor:
        kernel = (normals @ directions.T).clamp(min=0) * (axes @ directions.T < cosine)
        return (4 * math.pi / len(directions)) * kernel @ sh.basis(directions, 5)

    def from_square(points: torch.Tensor) -> torch.Tensor:
        z, phi = 2 * points[:, 0] - 1, 2 * math.pi * points[:, 1]
        radius = torch.sqrt(1 - z * z)
        return torch.stack([radius * torch.cos(phi), radius * torch.sin(phi), z], -1)

    def sets(name: str, count: int) -> list[torch.Tensor]:
        if name == "spherical Fibonacci":
            return [sh.fibonacci(count)[0]]
        if name == "Sobol":
            engines = (torch.quasirandom.SobolEngine(2, scramble=True, seed=seed) for seed in range(8))
            return [from_square(engine.draw(count, dtype=torch.float64)) for engine in engines]
        return [from_square(torch.rand(count, 2, generator=generator, dtype=torch.float64)) for _ in range(8)]

    truth = project(sh.fibonacci(200_000)[0])
    table = Table("directions: RMS error of the coefficients of a shadowed cosine, order 5, published / torchprt")
    for name, row in known.items():
        columns = {}
        for count, published in zip(counts, row, strict=True):
            squares = [(project(each) - truth).square().mean() for each in sets(name, count)]
            columns[str(count)] = f"{published:.1e} / {float(torch.stack(squares).mean().sqrt()):.1e}"
        table.add(name, extra=columns)
    return table


def run() -> None:
    """Prints every table."""
    torch.set_num_threads(1)
    console = Console(width=None if sys.stdout.isatty() else 120)
    for make in (basis_accuracy, rotation_accuracy, cube_maps, gaunt_counts, hemisphere, direction_sets, *LOBES):
        console.print(make())


if __name__ == "__main__":
    run()
