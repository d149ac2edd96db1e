"""Wrinkles: parallel sinusoidal grooves, whose transfer needs no rays."""

from __future__ import annotations

import dataclasses
import math

import torch
from jaxtyping import Float64
from torch import Tensor

from torchprt.compression.bilinear import fit_bilinear
from torchprt.errors import InputError
from torchprt.sh import basis
from torchprt.transfer import Transfer
from torchprt.version import VERSION

# Cells of the finer signal a texel of the map, along each axis.
FINER = 2
_NODES = 24
_CHUNK = 512


def wrinkle(size: int | tuple[int, int] = 32, *, depth: float | int = 0.3, order: int = 6, lobes: int = 3) -> Transfer:
    """A smooth map of the lobes of wrinkles over (x, depth), to be laid on a surface through its texture coordinates.

    u is the place across a groove, of width 1 from ridge to ridge, and repeats itself; v is its depth, from 0 (flat)
    at v = 0 to `depth` at v = 1, in widths of a groove. So the texture coordinates of a surface say where its wrinkles
    run and how deep they are. The transfer is that of `groove_transfer`; one fit of all texels makes the lobes
    correspond (`compression.fit_bilinear`), so they are interpolated and wrinkles show no steps.

    Raises InputError if `depth` is not above 0, or as `fit_bilinear` does.
    Source: Sloan, Luna and Snyder 2005, section 4.2 (wrinkle model).
    """
    if not 0 < depth < math.inf:
        raise InputError(f"depth is {depth:g}: give the depth of the deepest groove, in widths, above 0")
    rows, columns = (size, size) if isinstance(size, int) else size
    x = (torch.arange(FINER * columns, dtype=torch.float64) + 0.5) / (FINER * columns)
    deep = (torch.arange(FINER * rows, dtype=torch.float64) + 0.5) / (FINER * rows) * depth
    vectors = groove_transfer(x, deep[:, None], order)
    found = fit_bilinear(vectors.movedim(-1, 0)[None], (rows, columns), lobes=lobes, tiles_u=True)
    signal = float(vectors.square().mean().sqrt())
    return dataclasses.replace(found, transport="shadowed", signal=signal, error=0.0, version=VERSION)


def groove_transfer(x: Float64[Tensor, "*#B"], depth: Float64[Tensor, "*#B"], order: int) -> Float64[Tensor, "*B N"]:
    """Transfer vectors `(1/pi) int H_N V y_i` on the surface z = depth / 2 (cos(2 pi x) - 1), endless along x and y.

    A ray is blocked if its slope in the plane of x and z is below that of the horizon, whatever its part along y, so
    visible directions are an interval of the angle in that plane: integrated by Gauss-Legendre rules within it, exact
    to 1e-10. Slopes of the horizon are those of depth 1 times the depth.
    Source: Sloan, Luna and Snyder 2005, section 4.2; the horizon after Max 1988.
    """
    x, depth = torch.broadcast_tensors(x, depth)
    shape = x.shape
    x, depth = x.flatten(), depth.flatten()
    right, left = depth * _horizon(x), depth * _horizon(-x)
    slope = -math.pi * depth * torch.sin(2 * math.pi * x)
    chunks = zip(right.split(_CHUNK), left.split(_CHUNK), slope.split(_CHUNK), strict=True)
    found = [_integral(*chunk, order) for chunk in chunks]
    return torch.cat([x.new_zeros(0, order * order), *found]).view(*shape, order * order)


def _horizon(x: Float64[Tensor, "P"]) -> Float64[Tensor, "P"]:
    """The greatest slope from the point at `x` to any point of the surface on the side of +x, for depth 1."""
    found = []
    for part in x.split(_CHUNK):
        # Beyond the next ridge there is nothing steeper: its copies are farther away.
        step = torch.linspace(0, 1, 2049, dtype=torch.float64)[1:]
        middle = part[:, None] + step / 2
        # (cos a - cos b) / 2 as a product: no cancellation near the point itself.
        slopes = -math.pi * torch.sin(2 * math.pi * middle) * torch.sinc(step)
        # The parabola through the highest three, where the highest is between two others.
        at = slopes.argmax(1).clamp(1, len(step) - 2)
        below, here, above = (slopes.gather(1, (at + k)[:, None])[:, 0] for k in (-1, 0, 1))
        bend = below - 2 * here + above
        within = (here >= below) & (here >= above) & (bend < 0)
        top = here - torch.where(within, (above - below).square() / (8 * torch.where(within, bend, 1.0)), 0.0)
        itself = -math.pi * torch.sin(2 * math.pi * part)
        found.append(torch.stack([top, slopes.amax(1), itself, torch.zeros_like(part)]).amax(0))
    return torch.cat([x.new_zeros(0), *found])


def _integral(
    right: Float64[Tensor, "P"], left: Float64[Tensor, "P"], slope: Float64[Tensor, "P"], order: int
) -> Float64[Tensor, "P N"]:
    from numpy.polynomial.legendre import leggauss

    nodes, weights = (torch.from_numpy(part) for part in leggauss(_NODES))
    low, high = right.atan(), math.pi - left.atan()
    half = (high - low) / 2
    around = low[:, None] + half[:, None] * (nodes + 1)
    normal = math.pi / 2 + slope.atan()
    # Along y: the angle out of the plane.
    out = math.pi / 2 * nodes
    cosine, sine = out.cos(), out.sin()
    flat = torch.stack([around.cos(), torch.zeros_like(around), around.sin()], -1)
    directions = flat[:, :, None] * cosine[:, None] + sine[:, None] * torch.tensor([0.0, 1.0, 0.0])
    facing = (around - normal[:, None]).cos() * weights * half[:, None]
    measure = facing[:, :, None] * (cosine.square() * weights * math.pi / 2)
    values = basis(directions, order)
    return torch.einsum("pab,pabn->pn", measure, values) / math.pi
