"""Maps of lobes that may be interpolated: one fit of all texels at once, to a finer signal."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.errors import InputError
from torchprt.sh import bands, basis, order_of
from torchprt.transfer import Diffuse, Texels, Transfer, Zonal

# Of the mean square of the signal a coefficient: keeps lobes that nearly coincide from growing against each other.
RIDGE = 1e-6


def fit_bilinear(
    vectors: Float[Tensor, "C N I J"],
    size: tuple[int, int],
    *,
    lobes: int = 3,
    tiles_u: bool = False,
    tiles_v: bool = False,
    iterations: int = 150,
) -> Transfer:
    """A smooth map of lobes from transfer vectors that sample it more finely.

    `vectors` at the centres of I x J cells of the unit square (rows along v), in the tangent frame; `size` (rows,
    columns) of the map. Every parameter of a lobe is a bilinear function: that the finer signal must be met between
    texels is what makes the lobes of neighbours correspond. Bands 0 and 1 are apart, and linear least squares. The
    others start from the optimal linear axis and further axes turned away from it by equal and opposite angles, with
    their best coefficients, in the plane and by the angle that fit best; then all texels are refined together (L-BFGS).
    `squared_error` of a texel is the mean over the cells nearest to it. The albedo is 1. Double precision throughout,
    on the CPU wherever the vectors are.

    Raises InputError if `vectors` are not finite or not finer than the map, the order is below 3, or `lobes` below 1.
    Source: Sloan, Luna and Snyder 2005, section 4.2 (which used conjugate gradients).
    """
    rows, columns = size
    count, fine_rows, fine_columns = vectors.shape[1:]
    order = order_of(count)
    if order < 3 or lobes < 1:
        raise InputError(f"order is {order} and lobes {lobes}: give transfer of order 3 or more and at least one lobe")
    if fine_rows < rows or fine_columns < columns or min(rows, columns) < 1:
        raise InputError(
            f"vectors are {fine_rows} x {fine_columns} for a map of {rows} x {columns}: give at least one a texel"
        )
    if not bool(torch.isfinite(vectors).all()):
        raise InputError("vectors hold NaN or infinity: bake them again")
    # scipy minimises there.
    with torch.device("cpu"):
        return _fitted(vectors.detach().cpu().double(), size, lobes, tiles_u, tiles_v, iterations)


def _fitted(
    vectors: Tensor, size: tuple[int, int], lobes: int, tiles_u: bool, tiles_v: bool, iterations: int
) -> Transfer:
    (rows, columns), order = size, order_of(vectors.shape[1])
    fine_rows, fine_columns = vectors.shape[2:]
    largest = vectors.abs().amax()
    scale = torch.where(largest > 0, largest, 1.0)
    signal = vectors / scale
    down, across = interpolation(fine_rows, rows, tiles_v), interpolation(fine_columns, columns, tiles_u)
    # Orthonormal bases make the least-squares fit of a bilinear function separable.
    coarse = torch.linalg.pinv(down) @ signal @ torch.linalg.pinv(across).mT
    axis, coefficients = _refine(signal, coarse, down, across, lobes, order, iterations)
    fitted = reconstruct(axis, coefficients, coarse[:, :4], down, across)
    squared = (fitted - signal).square().sum((0, 1))
    share = (down / down.sum(0)).mT @ squared @ (across / across.sum(0))
    whole = float(signal.square().sum())
    lobes_of_texels = Zonal(
        axis=axis.flatten(-2)[None],
        coefficients=(scale * coefficients).flatten(-2)[:, None],
        exact=(scale * coarse[:, :4]).flatten(-2)[:, None],
        squared_error=(scale.square() * share).flatten(),
        smooth=True,
        fit_error=float(squared.sum() / whole) ** 0.5 if whole else 0.0,
    )
    layer = Diffuse(albedo=torch.ones(1, 1, dtype=torch.float64), signal=lobes_of_texels)
    texels = Texels(rows=rows, columns=columns, tiles_u=tiles_u, tiles_v=tiles_v)
    return Transfer(receivers=texels, layers={"diffuse": layer})


def interpolation(fine: int, coarse: int, tiles: bool) -> Float64[Tensor, "fine coarse"]:
    """The matrix that reads a bilinear function of `coarse` texels at the centres of `fine` cells, along one axis."""
    place = (torch.arange(fine, dtype=torch.float64) + 0.5) * coarse / fine - 0.5
    low = place.floor().long()
    share = place - low
    matrix = torch.zeros(fine, coarse, dtype=torch.float64)
    for number, weight in ((low, 1 - share), (low + 1, share)):
        number = number % coarse if tiles else number.clamp(0, coarse - 1)
        matrix.scatter_add_(1, number[:, None], weight[:, None])
    return matrix


def reconstruct(
    axis: Float[Tensor, "L 3 H W"],
    coefficients: Float[Tensor, "C L Z H W"],
    exact: Float[Tensor, "C 4 H W"],
    down: Float[Tensor, "I H"],
    across: Float[Tensor, "J W"],
) -> Float[Tensor, "C N I J"]:
    """Transfer vectors where the interpolation matrices read a smooth map, as `shade.sample` does."""
    order = coefficients.shape[2] + 2
    axes = normalize(down @ axis @ across.mT, dim=1)
    weights = down @ coefficients @ across.mT
    values = basis(axes.movedim(1, -1), order).movedim(-1, 1)
    high = (values[:, 4:] * weights[:, :, bands(order)[4:] - 2]).sum(1)
    return torch.cat([down @ exact @ across.mT, high], 1)


def _refine(
    signal: Tensor, coarse: Tensor, down: Tensor, across: Tensor, lobes: int, order: int, iterations: int
) -> tuple[Tensor, Tensor]:
    scale = signal[:, 4:].square().sum()
    if not bool(scale > 0):
        axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[None, :, None, None]
        shape = coarse.shape[-2:]
        return axis.expand(lobes, 3, *shape), torch.zeros(len(signal), lobes, order - 2, *shape, dtype=torch.float64)
    from scipy.optimize import minimize

    axis, coefficients = _start(coarse, lobes, order)
    # Both are of the size of 1, as a quasi-Newton method likes them.
    size = coefficients.square().mean().sqrt().clamp(min=1e-300)
    parts = [axis.flatten(), (coefficients / size).flatten()]
    none = torch.zeros_like(coarse[:, :4])

    def lobes_of(unknown: Tensor) -> tuple[Tensor, Tensor]:
        one, other = unknown.split([len(part) for part in parts])
        return normalize(one.view_as(axis), dim=1), other.view_as(coefficients)

    def objective(values: np.ndarray) -> tuple[float, np.ndarray]:
        unknown = torch.from_numpy(values).requires_grad_(True)
        turned, scaled = lobes_of(unknown)
        found = reconstruct(turned, size * scaled, none, down, across)
        loss = (found - signal)[:, 4:].square().sum() / scale + RIDGE * scaled.square().mean()
        (slope,) = torch.autograd.grad(loss, unknown)
        return loss.item(), slope.numpy()

    limits = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30, "ftol": 0.0, "gtol": 0.0}
    with torch.inference_mode(False), torch.enable_grad():
        best = minimize(objective, torch.cat(parts).numpy(), jac=True, method="L-BFGS-B", options=limits)
    turned, scaled = lobes_of(torch.from_numpy(best.x))
    return turned, size * scaled


def _start(coarse: Tensor, lobes: int, order: int) -> tuple[Tensor, Tensor]:
    """Lobes around the optimal linear axis, in the plane and by the angle of the least error over all texels."""
    total = coarse.sum(0)
    linear = normalize(torch.stack([-total[3], -total[1], total[2]]), dim=0)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)[:, None, None].expand_as(linear)
    linear = torch.where(linear.abs().sum(0) > 0, linear, up)
    best: tuple[float, Tensor, Tensor] | None = None
    for plane in range(2):
        # Orthogonal to the axis, along v or along u; the same in all texels, so that lobes correspond.
        along = torch.eye(3, dtype=torch.float64)[1 - plane][:, None, None].expand_as(linear)
        along = normalize(along - (along * linear).sum(0) * linear, dim=0)
        for angle in torch.linspace(0.15, 1.3, 12, dtype=torch.float64):
            steps = torch.tensor([(k + 1) // 2 * (-1) ** k for k in range(lobes)], dtype=torch.float64)
            turns = (steps * angle)[:, None, None, None]
            axis = turns.cos() * linear + turns.sin() * along
            coefficients, error = _best_coefficients(axis, coarse, order)
            if best is None or error < best[0]:
                best = error, axis, coefficients
    assert best is not None
    return best[1], best[2]


def _best_coefficients(
    axis: Float[Tensor, "L 3 H W"], vectors: Float[Tensor, "C N H W"], order: int
) -> tuple[Float[Tensor, "C L Z H W"], float]:
    """Least squares, band by band, and the squared error of bands from 2 on."""
    values = basis(axis.movedim(1, -1), order)
    found, error = [], 0.0
    for l in range(2, order):
        rows = slice(l * l, (l + 1) ** 2)
        matrix = values[..., rows].movedim(0, -1)
        target = vectors[:, rows].movedim(1, -1)[..., None]
        gram = matrix.mT @ matrix + 1e-4 * torch.eye(len(axis), dtype=torch.float64)
        band = torch.linalg.solve(gram, matrix.mT @ target)
        error += float((matrix @ band - target).square().sum())
        found.append(band[..., 0].movedim(-1, 1))
    return torch.stack(found, 2), error
