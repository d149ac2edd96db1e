"""Environments as cube maps and as latitude-longitude maps: from one to the other, and to coefficients."""

import functools
import math
from collections.abc import Callable

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from torchprt import sh
from torchprt.errors import InputError
from torchprt.sh.basis import values_are_at_hand
from torchprt.sh.constant import remembered
from torchprt.sh.derivatives import read_bilinear

# Samples taken at once, so that a large map does not need many times its size in memory.
CHUNK = 1 << 21


def project(image: Float[Tensor, "*S 3"], order: int) -> Float[Tensor, "*B N 3"]:
    """The light of an environment: the coefficients of its radiance, to `order`.

    `image` is a latitude-longitude map `[*B, H, 2H, 3]` or a cube map `[*B, 6, H, H, 3]` of linear radiance,
    laid out as in docs/conventions.md. Texel weights are those of `sh.project_latlong` and `sh.project_cube`.

    Raises InputError for any other shape, and for radiance that is negative or not finite.
    Source: Sloan, Kautz and Snyder 2002, section 3, equation 1.
    """
    cube = image.ndim >= 4 and image.shape[-4] == 6 and image.shape[-3] == image.shape[-2] > 0
    if not cube:
        _check_latlong(image)
    _check_radiance(image)
    return sh.project_cube(image, order) if cube else sh.project_latlong(image, order)


def latlong_to_cube(image: Float[Tensor, "*B H W C"], size: int) -> Float[Tensor, "*B 6 S S C"]:
    """The cube map, `size` texels along an edge, of a latitude-longitude map with W = 2H.

    Each texel is the mean over its solid angle of the bilinear reconstruction of `image`, taken at no fewer than
    two samples to an image texel, so that shrinking neither aliases nor loses energy; longitude closes and rows
    go on beyond the poles. Differentiable in `image`.

    Raises InputError if W is not 2H or `size` is below 1.
    """
    _check_latlong(image)
    _check_size("size", size)
    height = image.shape[-3]
    samples = math.ceil(2 * (2 / size) / (math.pi / height))
    atlas = _planes(_extend_latlong(image))
    radiance = functools.partial(_sample_latlong, atlas)
    faces = [_cube_face(radiance, face, size, samples, image) for face in range(6)]
    cube = torch.stack(faces, dim=1)
    return cube.movedim(2, -1).reshape(*image.shape[:-3], 6, size, size, image.shape[-1])


def cube_to_latlong(cube: Float[Tensor, "*B faces S T C"], height: int) -> Float[Tensor, "*B H W C"]:
    """The latitude-longitude map of `height` rows and twice as many columns of a cube map.

    Each texel is the mean over its solid angle of the bilinear reconstruction of `cube`, in which faces meet
    without seams: beyond an edge comes the texel of the neighbouring face, beyond a corner the mean of the three.
    Differentiable in `cube`.

    Raises InputError unless there are six square faces, or if `height` is below 1.
    """
    if cube.shape[-4] != 6 or cube.shape[-3] != cube.shape[-2] or cube.numel() == 0:
        raise InputError(f"a cube map has shape [..., 6, H, H, C], not {tuple(cube.shape)}: give six square faces")
    _check_size("height", height)
    size = cube.shape[-2]
    samples = math.ceil(math.pi * size / height)
    atlas = _planes(_extend_cube(cube).flatten(-4, -3))
    radiance = functools.partial(_sample_cube, atlas)
    rows = max(1, CHUNK // (2 * height * samples**2))
    bands = [
        _latlong_rows(radiance, first, min(first + rows, height), height, samples, cube)
        for first in range(0, height, rows)
    ]
    image = torch.cat(bands, dim=-2)
    return image.movedim(1, -1).reshape(*cube.shape[:-4], height, 2 * height, cube.shape[-1])


def _check_latlong(image: Tensor) -> None:
    if image.ndim < 3 or image.shape[-2] != 2 * image.shape[-3] or image.numel() == 0:
        raise InputError(
            f"an environment has shape [..., H, 2H, 3] or [..., 6, H, H, 3], not {tuple(image.shape)}: "
            "crop or resize the image"
        )


def _check_size(name: str, size: int) -> None:
    if size < 1:
        raise InputError(f"{name} must be at least 1, not {size}")


def _check_radiance(image: Tensor) -> None:
    if not values_are_at_hand(image):
        return
    low, high = torch.aminmax(image.detach())
    if not (bool(low.isfinite()) and bool(high.isfinite())):
        raise InputError("the image holds values that are not finite: read its file with light.read(repair=True)")
    if low < 0:
        raise InputError(f"the image holds negative radiance ({float(low):.6g}): read its file with light.read")


def _planes(image: Float[Tensor, "*B H W C"]) -> Float[Tensor, "b C H W"]:
    return image.reshape(-1, *image.shape[-3:]).movedim(-1, 1)


def _extend_latlong(image: Float[Tensor, "*B H W C"]) -> Float[Tensor, "*B H2 W2 C"]:
    """One more texel all around: across a pole lies the same row, half a turn away."""
    across = image.roll(image.shape[-2] // 2, dims=-2)
    tall = torch.cat([across[..., :1, :, :], image, across[..., -1:, :, :]], dim=-3)
    return torch.cat([tall[..., -1:, :], tall, tall[..., :1, :]], dim=-2)


def _extend_cube(cube: Float[Tensor, "*B 6 S S C"]) -> Float[Tensor, "*B 6 S2 S2 C"]:
    size, channels = cube.shape[-2], cube.shape[-1]
    first, second, third = _neighbours(cube.device, size)
    texels = cube.reshape(*cube.shape[:-4], 6 * size * size, channels)
    around = (texels[..., first, :] + texels[..., second, :] + texels[..., third, :]) / 3
    return around.reshape(*cube.shape[:-4], 6, size + 2, size + 2, channels)


@remembered(16)
def _neighbours(size: int) -> tuple[Tensor, Tensor, Tensor]:
    """For every texel of the extended faces the three texels whose mean it is (three times the same, mostly)."""
    # A little beyond an edge, at the height of the texel, lies the neighbour that shares the edge.
    inside = (torch.arange(size, dtype=torch.float64) + 0.5) * 2 / size - 1
    beyond = 1 + 0.01 / size
    line = torch.cat([torch.tensor([-beyond]), inside, torch.tensor([beyond])]).double()
    t, s = torch.meshgrid(line, line, indexing="ij")

    def texel(s: Tensor, t: Tensor) -> Tensor:
        directions = torch.stack([_direction(face, s, t) for face in range(6)])
        face, s, t = _face_of(directions)
        column, row = (((1 + c) * size / 2).long().clamp(0, size - 1) for c in (s, t))
        return ((face.long() * size + row) * size + column).flatten()

    corner = (s.abs() > 1) & (t.abs() > 1)
    within = line.clamp(inside[0], inside[-1])
    near_t, near_s = torch.meshgrid(within, within, indexing="ij")
    return (
        texel(torch.where(corner, near_s, s), torch.where(corner, near_t, t)),
        texel(s, torch.where(corner, near_t, t)),
        texel(torch.where(corner, near_s, s), t),
    )


def _direction(face: int, s: Tensor, t: Tensor) -> Tensor:
    """The direction, not of unit length, at (s, t) of a face (docs/conventions.md)."""
    one = torch.ones_like(s)
    return torch.stack(
        [(one, -t, -s), (-one, -t, s), (s, one, t), (s, -one, -t), (s, -t, one), (-s, -t, -one)][face], dim=-1
    )


def _face_of(directions: Float[Tensor, "*D 3"]) -> tuple[Tensor, Tensor, Tensor]:
    """The face (as a float) that each direction meets, and where, s and t in [-1, 1]."""
    x, y, z = directions.unbind(-1)
    a, b, c = x.abs(), y.abs(), z.abs()
    on_x, on_y = (a >= b) & (a >= c), b >= c
    depth = torch.where(on_x, a, torch.where(on_y, b, c))
    face = torch.where(on_x, 0 + (x < 0).int(), torch.where(on_y, 2 + (y < 0).int(), 4 + (z < 0).int()))
    s = torch.where(on_x, -z * x.sign(), torch.where(on_y, x, x * z.sign()))
    t = torch.where(on_x, -y, torch.where(on_y, z * y.sign(), -y))
    return face.to(directions.dtype), s / depth, t / depth


def _sample_latlong(atlas: Float[Tensor, "b C H W"], directions: Float[Tensor, "h w 3"]) -> Float[Tensor, "b C h w"]:
    height = atlas.shape[-2] - 2
    x, y, z = directions.unbind(-1)
    column = (torch.atan2(x, -z) / math.pi + 1) * height
    row = torch.atan2(torch.hypot(x, z), y) / math.pi * height
    return _bilinear(atlas, column + 1, row + 1)


def _sample_cube(atlas: Float[Tensor, "b C H W"], directions: Float[Tensor, "h w 3"]) -> Float[Tensor, "b C h w"]:
    """The extended faces lie one below the other."""
    size = atlas.shape[-1] - 2
    face, s, t = _face_of(directions)
    column, row = ((1 + coordinate) * (size / 2) + 1 for coordinate in (s, t))
    return _bilinear(atlas, column, row + face * (size + 2))


def _bilinear(atlas: Float[Tensor, "b C H W"], column: Tensor, row: Tensor) -> Float[Tensor, "b C h w"]:
    """Between the centres of texels, which are at a half."""
    height, width = atlas.shape[-2:]
    grid = torch.stack([column * (2 / width) - 1, row * (2 / height) - 1], dim=-1)
    grid = grid.to(atlas.dtype).expand(atlas.shape[0], *grid.shape)
    return read_bilinear(atlas, grid)


def _cube_face(
    radiance: Callable[[Tensor], Tensor], face: int, size: int, samples: int, like: Tensor
) -> Float[Tensor, "b C S S"]:
    line = _centres(size * samples, like) * 2 - 1
    step = max(1, CHUNK // (size * samples**2)) * samples
    pieces = []
    for part in line.split(step):
        t, s = torch.meshgrid(part, line, indexing="ij")
        weights = (1 + s * s + t * t) ** -1.5
        pieces.append(_mean(radiance(_direction(face, s, t)), weights, samples))
    return torch.cat(pieces, dim=-2)


def _latlong_rows(radiance, first: int, last: int, height: int, samples: int, like: Tensor) -> Float[Tensor, "b C h W"]:
    theta = _centres(height * samples, like)[first * samples : last * samples] * math.pi
    phi = (_centres(2 * height * samples, like) * 2 - 1) * math.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    sine = theta.sin()
    directions = torch.stack([phi.sin() * sine, theta.cos(), -phi.cos() * sine], dim=-1)
    return _mean(radiance(directions), sine, samples)


def _centres(count: int, like: Tensor) -> Float[Tensor, " count"]:
    # Counted in float64: float32 would place the samples of a large map by hundredths of a texel.
    return ((torch.arange(count, dtype=torch.float64, device=like.device) + 0.5) / count).to(like.dtype)


def _mean(values: Float[Tensor, "b C h w"], weights: Float[Tensor, "h w"], samples: int) -> Tensor:
    """Weighted mean over blocks of `samples` x `samples`."""
    total = F.avg_pool2d(weights[None, None], samples)
    return F.avg_pool2d(values * weights, samples) / total
