"""Zonal lobes in a pose: as SH coefficients, or straight to radiance from a table of the light."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import basis, order_of
from torchprt.sh.basis import only_values_are_wanted
from torchprt.sh.constant import remembered
from torchprt.sh.derivatives import read_bilinear
from torchprt.sh.precision import widened, without_autocast
from torchprt.sh.shapes import broadcast_shapes

# Rows and columns of the table of a light.
TABLE = (32, 64)
# Receivers whose basis functions are held at a time: larger buffers are fresh pages of the system at every call.
BLOCK = 16384


def turned_axes(axis: Float[Tensor, "L 3 V"], frames: Float[Tensor, "*P V 3 3"] | None) -> Float[Tensor, "3 L ..."]:
    """Axes `F axis` of every lobe in every pose, `[3, L, *P, V]`; as they are without `frames`."""
    lanes = axis.movedim(1, 0)
    if frames is None:
        return lanes
    turn = frames.movedim((-2, -1), (0, 1))
    lanes = lanes.reshape(3, len(axis), *(1,) * (turn.ndim - 3), axis.shape[-1])
    if not only_values_are_wanted(axis, frames):
        return (turn.unsqueeze(2) * lanes).sum(1)
    turned = axis.new_empty(3, len(axis), *turn.shape[2:])
    for row, part in zip(turn.unbind(0), turned.unbind(0), strict=True):
        torch.mul(row[0], lanes[0], out=part).addcmul_(row[1], lanes[1]).addcmul_(row[2], lanes[2])
    return turned


def turned_exact(
    exact: Float[Tensor, "C 4 *#P V"], frames: Float[Tensor, "*#P V 3 3"] | None
) -> Float[Tensor, "C 4 ..."]:
    """SH coefficients of bands 0 and 1 in every pose."""
    if frames is None:
        return exact
    turn = frames.movedim((-2, -1), (0, 1))
    # y_1m are -y, z, -x: the band is the vector (x, y, z) = (-t_1,1, -t_1,-1, t_1,0).
    constant, y, z, x = exact.unbind(1)
    x, y, z = (turn[row, 2] * z - turn[row, 0] * x - turn[row, 1] * y for row in range(3))
    return torch.stack([constant.expand_as(x), -y, z, -x], 1)


def lobe_vectors(
    axes: Float[Tensor, "3 L *#P V"], coefficients: Float[Tensor, "C L Z *#P V"], low: Float[Tensor, "C J *#P V"]
) -> Float[Tensor, "C N ..."]:
    """SH coefficients `sum_k y_lm(axes_k) coefficients_kl` of V receivers in every pose, `[C, N, *P, V]`; after `low`
    (J = 4), which are bands 0 and 1, the lobes begin at band 2. Axes count as unit vectors whatever their length.

    Where only values are wanted the lobes are added one after another in place, five times faster.
    Source: Sloan, Luna and Snyder 2005, section 4.
    """
    first = 2 if low.shape[1] else 0
    order = coefficients.shape[2] + first
    poses = broadcast_shapes(axes.shape[2:], coefficients.shape[3:], low.shape[2:])
    if only_values_are_wanted(axes, coefficients, low):
        return _in_place(axes, coefficients, low, order, poses)
    values = basis(_unit(axes).movedim(0, -1), order).movedim(-1, 0)
    bands = [low.expand(*low.shape[:2], *poses)] if first else []
    for l in range(first, order):
        band = (values[l * l : (l + 1) ** 2] * coefficients[:, :, l - first].unsqueeze(1)).sum(2)
        bands.append(band.expand(*band.shape[:2], *poses))
    return torch.cat(bands, 1)


def _unit(axes: Float[Tensor, "3 *L"]) -> Float[Tensor, "3 *L"]:
    """Axes at unit length; zero stays zero, with finite gradients."""
    x, y, z = axes.unbind(0)
    # `normalize` is ten times slower where components come first in memory.
    return axes * torch.rsqrt((x * x + y * y + z * z).clamp(min=torch.finfo(axes.dtype).tiny))


def _in_place(
    axes: Tensor, coefficients: Tensor, low: Tensor, order: int, poses: tuple[int, ...] | torch.Size
) -> Tensor:
    first = 2 if low.shape[1] else 0
    # In memory one matrix `[N, V]` a pose, as products with lights read it.
    memory = axes.new_zeros if not axes.shape[1] else axes.new_empty
    vectors = memory(len(coefficients), *poses[:-1], order * order, poses[-1]).movedim(-2, 1)
    for start in range(0, poses[-1], BLOCK):
        some = slice(start, start + BLOCK)
        for lobe, axis in enumerate(axes[..., some].unbind(1)):
            # Here, where a block is in the cache: over all axes at once it takes a quarter of the whole.
            values = basis(_unit(axis).movedim(0, -1), order).movedim(-1, 0)
            for l in range(first, order):
                rows = slice(l * l, (l + 1) ** 2)
                for channel, weights in zip(
                    vectors[..., some], coefficients[:, lobe, l - first, ..., some], strict=True
                ):
                    if lobe:
                        channel[rows].addcmul_(values[rows], weights)
                    else:
                        torch.mul(values[rows], weights, out=channel[rows])
    if first:
        vectors[:, :4] = low
    return vectors


def table_radiance(
    light: Float[Tensor, "*#P N 3"],
    axes: Float[Tensor, "3 L *#P V"],
    coefficients: Float[Tensor, "C L Z *#P V"],
    low: Float[Tensor, "C J *#P V"],
) -> Float[Tensor, "... 3 V"]:
    """`lobe_vectors . light` without the vectors: `sum_l coefficients_l e_l(axis)` of every lobe, where the functions
    e_l(s) = sum_m y_lm(s) light_lm are read from a table over latitude and longitude, bilinear.

    Of a lobe the error is about (l h)^2 / 8 of its band l, h = 5.6 degrees the width of a texel: .4 % at order 3 and
    3 % at order 6.
    Source: Sloan, Luna and Snyder 2005, section 4.3.
    """
    dtype, light = light.dtype, widened(light)
    first = 2 if low.shape[1] else 0
    batch = broadcast_shapes(light.shape[:-2], axes.shape[2:-1], coefficients.shape[3:-1], low.shape[2:-1])
    axes = _unit(axes)
    table = light_table(light, first)
    table = table.expand(*batch, *table.shape[-3:]).reshape(-1, *table.shape[-3:])
    places = table_places(axes).movedim(0, -3)
    places = places.expand(*batch, *places.shape[-3:]).reshape(-1, *places.shape[-3:])
    read = read_bilinear(table, places)
    read = read.reshape(*batch, coefficients.shape[2], 3, *read.shape[-2:])
    weights = coefficients.movedim((2, 0, 1), (-4, -3, -2))
    radiance = (read * weights).sum((-4, -2))
    if first:
        rows = low.movedim((0, 1), (-3, -2))
        radiance = radiance + (light.mT[..., :4].unsqueeze(-1) * rows).sum(-2)
    return radiance.to(dtype)


@without_autocast
def light_table(light: Float[Tensor, "*B N 3"], first: int) -> Float[Tensor, "*B bands H W"]:
    """e_l of the bands from `first` on, three channels each, at the texel centres of latitudes and longitudes.

    Rows from +y down, columns from -z toward -x around the axis y, with a border of one texel: columns go on around,
    rows over the poles.
    """
    order = order_of(light.shape[-2])
    values = _table_basis(light.device, order, light.dtype)
    bands = [light.mT[..., l * l : (l + 1) ** 2] @ values[l * l : (l + 1) ** 2] for l in range(first, order)]
    if not bands:
        return light.new_zeros(*light.shape[:-2], 0, TABLE[0] + 2, TABLE[1] + 2)
    table = torch.cat(bands, -2).unflatten(-1, TABLE)
    above = torch.cat(
        [table[..., :1, :].roll(TABLE[1] // 2, -1), table, table[..., -1:, :].roll(TABLE[1] // 2, -1)], -2
    )
    return torch.cat([above[..., -1:], above, above[..., :1]], -1)


@remembered(8)
def _table_basis(order: int, dtype: torch.dtype) -> Float[Tensor, "N D"]:
    """The basis at the texel centres, row after row."""
    height, width = TABLE
    theta = (torch.arange(height, dtype=torch.float64) + 0.5) * (math.pi / height)
    phi = (torch.arange(width, dtype=torch.float64) + 0.5) * (2 * math.pi / width) - math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    directions = torch.stack([theta.sin() * phi.sin(), theta.cos(), theta.sin() * phi.cos()], -1)
    return basis(directions.to(dtype), order).reshape(height * width, order * order).T.contiguous()


def table_places(axes: Float[Tensor, "3 *D"]) -> Float[Tensor, "*D 2"]:
    """Where `grid_sample` finds unit directions in the table; a pole is at any longitude."""
    x, y, z = axes.unbind(0)
    squared = x * x + z * z
    off = squared > 0
    across = torch.where(off, torch.sqrt(torch.where(off, squared, 1.0)), 0.0)
    theta = torch.atan2(across, y)
    phi = torch.atan2(torch.where(off, x, 0.0), torch.where(off, z, 1.0))
    height, width = TABLE
    row, column = theta * (height / math.pi) + 1, (phi + math.pi) * (width / (2 * math.pi)) + 1
    return torch.stack([column * (2 / (width + 2)) - 1, row * (2 / (height + 2)) - 1], -1)
