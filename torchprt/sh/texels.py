"""Directions and solid angles of the texels of environment images, and the projection of such images.

Orientation of both kinds of image: docs/conventions.md.
"""

import functools
import math
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import linear

from torchprt.errors import InputError
from torchprt.sh.basis import basis
from torchprt.sh.constant import constant
from torchprt.sh.matrices import rotation_matrix
from torchprt.sh.precision import widened, without_autocast

Weights = Literal["normalised", "paper", "exact"]

# Numbers in a table that is kept between calls; larger ones are made and used a piece at a time.
_LARGEST_TABLE, _PIECE = 1 << 24, 1 << 21


def cube_directions(size: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, "6 H W 3"]:
    """Unit directions through the texel centres of a cube map with faces of `size` x `size` texels."""
    t, s = _face_coordinates(size)
    one = torch.ones_like(s)
    faces = [(one, -t, -s), (-one, -t, s), (s, one, t), (s, -one, -t), (s, -t, one), (-s, -t, -one)]
    directions = torch.stack([torch.stack(face, -1) for face in faces])
    return torch.nn.functional.normalize(directions, dim=-1).to(dtype)


def cube_weights(
    size: int, weights: Weights = "normalised", dtype: torch.dtype = torch.float64
) -> Float[Tensor, "6 H W"]:
    """What a texel counts for in an integral over the sphere, of three kinds.

    "paper": (4 / size^2) (1 + u^2 + v^2)^-1.5 of Sloan, Kautz and Snyder 2002, section 6.2; "normalised" (the
    default, the least error): the same scaled to sum to 4 pi; "exact": the solid angle of the texel.
    Raises InputError if `size` is below 1 or the kind is none of these.
    """
    v, u = _face_coordinates(size)
    if weights == "exact":
        edge = torch.linspace(-1, 1, size + 1, dtype=torch.float64)
        corner = torch.atan2(edge[:, None] * edge, torch.sqrt(edge[:, None] ** 2 + edge**2 + 1))
        face = corner.diff(dim=0).diff(dim=1)
    elif weights in ("normalised", "paper"):
        face = (4 / size**2) * (1 + u * u + v * v) ** -1.5
        if weights == "normalised":
            face = face * (4 * math.pi / 6 / face.sum())
    else:
        raise InputError(f"weights of kind {weights!r} are not known: use 'normalised', 'paper' or 'exact'")
    return face.to(dtype).expand(6, size, size)


def latlong_directions(height: int, width: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, "H W 3"]:
    """Unit directions through the texel centres of a latitude-longitude image."""
    theta, phi = (angle.to(torch.float64) for angle in _latlong_angles(height, width))
    around = torch.sin(theta)[:, None]
    up = torch.cos(theta)[:, None].expand(height, width)
    return torch.stack([around * torch.sin(phi), up, -around * torch.cos(phi)], -1).to(dtype)


def latlong_weights(height: int, width: int, dtype: torch.dtype = torch.float64) -> Float[Tensor, "H W"]:
    """The exact solid angles of the texels of a latitude-longitude image; they sum to 4 pi."""
    theta, _ = _latlong_angles(height, width)
    # cos(top) - cos(bottom) of a row, without the cancellation.
    row = 2 * torch.sin(theta) * math.sin(math.pi / (2 * height)) * (2 * math.pi / width)
    return row[:, None].expand(height, width).to(dtype)


def cube_basis(
    order: int, size: int, weights: Weights = "normalised", dtype: torch.dtype = torch.float32
) -> Float[Tensor, "N texels"]:
    """The weighted basis at the 6 `size`^2 texels of a cube map: coefficients are `table @ image`.

    For modules that keep it as a buffer. Computed in float64 and rounded once.
    """
    directions, area = cube_directions(size).reshape(-1, 3), cube_weights(size, weights).reshape(-1)
    return _weighted(directions, area, order, dtype)


def latlong_basis(order: int, height: int, width: int, dtype: torch.dtype = torch.float32) -> Float[Tensor, "N texels"]:
    """The weighted basis at the texels of a latitude-longitude image: coefficients are `table @ image`.

    For modules that keep it as a buffer: N times the size of the image. Computed in float64 and rounded once.
    """
    directions = latlong_directions(height, width).reshape(-1, 3)
    return _weighted(directions, latlong_weights(height, width).reshape(-1), order, dtype)


@without_autocast
def project_cube(
    cube: Float[Tensor, "*B 6 H W C"], order: int, weights: Weights = "normalised"
) -> Float[Tensor, "*B N C"]:
    """SH coefficients of cube maps: one matrix product with a table that is kept between calls.

    Faces so large that the table would exceed 2^24 numbers are projected a few rows at a time, without keeping it.
    Differentiable in `cube`. See `cube_weights` for the three kinds of `weights`. What is narrower than float32 is
    projected in float32, also under autocast.
    Raises InputError if the faces are not square.
    Source: Sloan, Kautz and Snyder 2002, section 6.2.
    """
    *batch, _, size, width, channels = cube.shape
    dtype, cube = cube.dtype, widened(cube)
    if size != width:
        raise InputError(f"cube has faces of {size} x {width} texels: they must be square")
    planes = cube.movedim(-1, -4)
    if order * order * 6 * size * size <= _LARGEST_TABLE:
        table = _cube_table(order, size, weights, cube.dtype, cube.device)
        flat = linear(planes.reshape(-1, 6 * size * size), table)
    else:
        directions = cube_directions(size, cube.dtype)
        area = cube_weights(size, weights, cube.dtype)
        flat = cube.new_zeros(math.prod(batch) * channels, order * order)
        rows = max(1, _PIECE // (order * order * size * 6))
        for start in range(0, size, rows):
            some = (slice(None), slice(start, start + rows))
            table = _weighted(directions[some].reshape(-1, 3), area[some].reshape(-1), order, cube.dtype)
            piece = planes[..., start : start + rows, :].reshape(flat.shape[0], -1)
            flat = flat + linear(piece, table.to(cube.device))
    return flat.reshape(*batch, channels, order * order).mT.to(dtype)


@without_autocast
def project_latlong(image: Float[Tensor, "*B H W C"], order: int) -> Float[Tensor, "*B N C"]:
    """SH coefficients of latitude-longitude images, with exact solid angles.

    Separable: a Fourier sum along every row, then a Legendre sum over the rows, about the vertical axis,
    which a constant rotation makes +y. The tables grow with H + W, so a 4096 x 2048 image costs hardly more
    than reading it. The same result as `latlong_basis(...) @ image` up to rounding. Differentiable in
    `image`. What is narrower than float32 is projected in float32, also under autocast.
    """
    dtype, image = image.dtype, widened(image)
    height, width = image.shape[-3:-1]
    around, down, index, upright = _latlong_tables(order, height, width, image.dtype, image.device)
    fourier = linear(image.movedim(-1, -3), around)
    return (upright @ (fourier[..., index] * down).sum(-2).mT).to(dtype)


def _face_coordinates(size: int) -> tuple[Tensor, Tensor]:
    if size < 1:
        raise InputError(f"size of a cube face must be at least 1 texel, not {size}")
    centre = (2 * torch.arange(size, dtype=torch.float64) + 1 - size) / size
    return centre[:, None].expand(size, size), centre.expand(size, size)


def _latlong_angles(height: int, width: int) -> tuple[Tensor, Tensor]:
    if height < 1 or width < 1:
        raise InputError(f"an image of {height} x {width} texels is empty: give at least 1 x 1")
    theta = math.pi * (torch.arange(height, dtype=torch.float64) + 0.5) / height
    phi = math.pi * (2 * torch.arange(width, dtype=torch.float64) + 1 - width) / width
    return theta, phi


def _weighted(directions: Tensor, area: Tensor, order: int, dtype: torch.dtype) -> Tensor:
    return (basis(directions, order).mT * area).to(dtype)


@constant
def _cube_table(order: int, size: int, weights: Weights, dtype: torch.dtype, device: torch.device) -> Tensor:
    build = _build_cube_table if torch.compiler.is_compiling() else _cached_cube_table
    return build(order, size, weights, dtype, device)


def _build_cube_table(order: int, size: int, weights: Weights, dtype: torch.dtype, device: torch.device) -> Tensor:
    return cube_basis(order, size, weights, dtype).to(device)


# Constants made in inference mode could never serve a gradient later.
_cached_cube_table = functools.lru_cache(maxsize=4)(torch.inference_mode(False)(_build_cube_table))


@constant
def _latlong_tables(
    order: int, height: int, width: int, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    build = _build_latlong_tables if torch.compiler.is_compiling() else _cached_latlong_tables
    return build(order, height, width, dtype, device)


def _build_latlong_tables(
    order: int, height: int, width: int, dtype: torch.dtype, device: torch.device
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    theta, phi = _latlong_angles(height, width)
    # In a frame whose z axis points up, phi runs clockwise seen from above.
    upright = torch.tensor([[0, -1, 0], [0, 0, 1], [-1, 0, 0]], dtype=torch.float64)
    m = torch.arange(-(order - 1), order)
    turns = m.abs()[:, None] * -phi
    around = torch.where(m[:, None] < 0, torch.sin(turns), torch.cos(turns))
    meridian = torch.stack([torch.sin(theta), torch.zeros_like(theta), torch.cos(theta)], -1)
    degree = torch.tensor([m for l in range(order) for m in range(-l, l + 1)])
    centre = torch.tensor([l * (l + 1) for l in range(order) for _ in range(2 * l + 1)])
    # On the meridian y_lm with m >= 0 is the Legendre part alone, and m < 0 shares that of |m|.
    down = basis(meridian, order)[:, centre + degree.abs()] * latlong_weights(height, width)[:, :1]
    return (
        around.to(device, dtype),
        down.to(device, dtype),
        (degree + order - 1).to(device),
        rotation_matrix(upright, order).to(device, dtype),
    )


_cached_latlong_tables = functools.lru_cache(maxsize=16)(torch.inference_mode(False)(_build_latlong_tables))
