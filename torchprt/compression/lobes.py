"""Vectors of SH coefficients as sums of zonal lobes, which turn by turning their axes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

from torchprt.compression.coherence import check_mesh
from torchprt.compression.lobe_axes import RIDGE, Target, sum_of_lobes
from torchprt.compression.lobe_refinement import Workers
from torchprt.compression.lobe_search import Search, cost
from torchprt.compression.smooth_lobes import PASSES, SMOOTHNESS, smooth_lobes, stages
from torchprt.compression.subspaces import one_thread
from torchprt.errors import InputError
from torchprt.progress import Report, Silent
from torchprt.sh import order_of

# From so many lobes on, three axes span the linear band.
_SPANNING = 3


@dataclass(frozen=True, eq=False)
class Lobes:
    """Vectors `t_lm ~ sum_k y_lm(axis_k) coefficients_kl`, channels sharing their axes.

    - `axis [L, 3, V]`: unit vectors; those of a vector of zeros are any.
    - `coefficients [C, L, Z, V]`: g*_l, of all bands, or of those from 2 on if `exact` holds the others.
    - `exact [C, J, V]`, J = 0 or 4: the coefficients of bands 0 and 1.
    - `error [V]`: squared error of every vector, over its channels and coefficients.
    """

    axis: Float[Tensor, "L 3 V"]
    coefficients: Float[Tensor, "C L Z V"]
    exact: Float[Tensor, "C J V"]
    error: Float64[Tensor, "V"]

    def reconstruct(self) -> Float[Tensor, "V C N"]:
        """The vectors that the lobes stand for."""
        first = 2 if self.exact.shape[1] else 0
        order = first + self.coefficients.shape[2]
        heights = self.coefficients.transpose(0, 1) * _units(order, first).to(self.coefficients)
        result = sum_of_lobes(self.axis, heights, order, first)
        result[: self.exact.shape[1]] = self.exact.transpose(0, 1)
        return result.permute(2, 1, 0)


def fit_lobes(
    vectors: Float[Tensor, "V C N"],
    lobes: int,
    *,
    smooth: bool = False,
    faces: Int[Tensor, "F 3"] | None = None,
    restarts: int = 0,
    seed: int = 0,
    exact: bool | None = None,
    smoothness: float = SMOOTHNESS,
    report: Report | None = None,
) -> Lobes:
    """Each of `vectors` as a sum of `lobes` zonal lobes of least squared error.

    Lobes are added one by one where they leave least and refined together. With `faces` or `restarts` they are also
    exchanged, and started anew from the axes of neighbours and so many times from random axes where the error is high:
    of four lobes on a scan without either, a third of the time and 1.5 times the error. Sums of so many lobes are
    found again to rounding if the search gets near them, as it always does for one. Lobes that come to coincide keep
    bounded coefficients; a vector of zeros has zeros. Sizes of the numbers do not matter. Same `seed`, same bits,
    however many threads torch has.

    - `exact`: bands 0 and 1 are stored apart; by default with three lobes or more (which span them), from order 2 on.
    - `smooth`: lobes of neighbours over `faces` correspond and can be interpolated, axes to be normalised after it. The
      more `smoothness`, the less they differ, and the larger the error.
    - `report` is told of vectors, of each as often as the search comes by it, about.

    Raises InputError if the vectors cannot be fitted, there is no lobe, or `smooth` without faces.
    Source: Sloan, Luna and Snyder 2005, section 4.1; Golub and Pereyra 1973.
    """
    order = _check(vectors, lobes, restarts, smoothness)
    if exact is None:
        exact = lobes >= _SPANNING and order >= 2
    if exact and order < 2:
        raise InputError(f"exact is set, but vectors of order {order} have no linear band: leave it out")
    if smooth and faces is None:
        raise InputError("smooth is set, but there are no faces that tell neighbours: give the triangles of the mesh")
    if faces is not None and (smooth or len(faces)):
        check_mesh(faces, len(vectors))
    generator, told = torch.Generator().manual_seed(seed), report or Silent()
    with torch.no_grad(), one_thread() as threads:
        first = 2 if exact else 0
        axis = vectors.new_zeros(lobes, 3, len(vectors))
        axis[:, 2] = 1
        signal = vectors.permute(2, 1, 0)
        none = torch.zeros(0, 2, dtype=torch.int64, device=vectors.device)
        edges = none if faces is None else edges_of(faces).to(vectors.device)
        found = vectors.new_zeros(lobes, vectors.shape[1], order - first, len(vectors))
        # Band 0 is the same about any axes.
        sought = max(first, 1)
        if sought < order and len(vectors):
            workers = Workers(threads)
            if smooth:
                pulls = stages(smoothness)
                told.start("smooth", (restarts + 1) * len(pulls) * PASSES * len(vectors))
                axis, heights = smooth_lobes(signal, lobes, sought, edges, workers, generator, pulls, restarts, told)
            else:
                told.start("lobes", cost(lobes, restarts, bool(len(edges) or restarts)) * len(vectors))
                axis, heights = _independent(signal, lobes, sought, edges, workers, generator, restarts, told)
            found[:, :, sought - first :] = heights
        if first == 0:
            found[:, :, 0] = signal[0] / lobes
        coefficients = (found / _units(order, first).to(found)).transpose(0, 1).contiguous()
        kept = signal[:4].transpose(0, 1) if exact else signal[:0].transpose(0, 1)
        unknown = vectors.new_zeros(len(vectors), dtype=torch.float64)
        made = Lobes(axis.contiguous(), coefficients, kept.contiguous(), unknown)
        return replace(made, error=(made.reconstruct() - vectors).double().square().sum((1, 2)))


def edges_of(faces: Int[Tensor, "F 3"]) -> Int[Tensor, "E 2"]:
    """Pairs of different vertices that share a triangle, each both ways round, once."""
    faces = faces.long()
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = torch.cat([edges, edges.flip(1)])
    edges = edges[edges[:, 0] != edges[:, 1]]
    base = int(edges.max()) + 1 if len(edges) else 1
    key = (edges[:, 0] * base + edges[:, 1]).unique()
    return torch.stack([key // base, key % base], 1)


def _independent(
    signal: Tensor,
    lobes: int,
    first: int,
    edges: Tensor,
    workers: Workers,
    generator: torch.Generator,
    restarts: int,
    report: Report,
) -> tuple[Tensor, Tensor]:
    """Axes and heights of every vector by itself, but for the neighbours that it starts from."""
    # Divided twice: squares of numbers of any size must neither vanish nor overflow.
    largest = signal[first * first :].abs().amax((0, 1))
    vectors = signal / torch.where(largest > 0, largest, 1.0)
    vectors[: first * first] = 0
    length = vectors.square().sum((0, 1)).sqrt()
    vectors = vectors / torch.where(length > 0, length, 1.0)
    size = largest.double() * length.double()
    ridge = RIDGE if lobes > 1 else 0.0
    search = Search(Target(vectors, first, ridge), size, edges, workers, report.advance, lobes)
    if len(edges) or restarts:
        # By itself it takes half as long again and gains 3 %; what it finds is spread to neighbours.
        search.exchange()
    search.restart(restarts, generator)
    heights = search.finish()
    return search.axes, (heights * size).to(heights)


def _units(order: int, first: int) -> Tensor:
    """Heights of lobes over their coefficients, `[Z, 1]`."""
    l = torch.arange(first, order, dtype=torch.float64, device="cpu")
    return ((2 * l + 1) / (4 * math.pi)).sqrt()[:, None]


def _check(vectors: Tensor, lobes: int, restarts: int, smoothness: float) -> int:
    """The order of vectors that can be fitted; InputError of others."""
    if vectors.dtype not in (torch.float32, torch.float64):
        raise InputError(f"vectors are {vectors.dtype}: pass float32 or float64")
    if vectors.ndim != 3 or vectors.shape[1] == 0:
        raise InputError(f"vectors have shape {tuple(vectors.shape)}: they must be [V, C, N], with channels")
    order = order_of(vectors.shape[2])
    if lobes < 1:
        raise InputError(f"lobes is {lobes}: there must be at least one")
    if restarts < 0:
        raise InputError(f"restarts is {restarts}: it must be 0 or more")
    if not 0 < smoothness < math.inf:
        raise InputError(f"smoothness is {smoothness}: it must be a number above 0, as {SMOOTHNESS}")
    if not vectors.isfinite().all():
        row = int((~vectors.isfinite()).any(2).any(1).nonzero()[0, 0])
        raise InputError(f"vectors hold a number that is not finite, first in row {row}: mend the transfer it is from")
    return order
