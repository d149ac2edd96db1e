"""Height fields as meshes: the patches that surfaces are covered with."""

from __future__ import annotations

import os

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt.errors import InputError
from torchprt.light import read

from .mesh import Mesh, make_mesh

LINEAR = (".exr", ".hdr", ".pic")


def height_field(heights: Float[Tensor, "H W"], depth: float | int = 1.0, name: str = "height field") -> Mesh:
    """The tileable patch over the unit square with a vertex at every height, z toward the eye.

    Row 0 lies at y = 0 and column 0 at x = 0; the row and the column at 1, which repeat them, are added, so copies
    shifted by 1 along x and y join without a seam: normals are those of the repeated surface. x runs along u, y
    along v, z along the normal of whatever the patch is laid on. Heights are multiplied by `depth`; a patch that is
    1 wide and .1 deep has its features as deep as a tenth of a tile.

    Raises InputError if there are fewer than 2 x 2 heights or if any is not finite.
    """
    if min(heights.shape) < 2:
        raise InputError(f"{name} has {heights.shape[0]} x {heights.shape[1]} heights: give at least 2 x 2")
    if not bool(torch.isfinite(heights).all()):
        raise InputError(f"{name} has heights that are not finite: remove them")
    z = heights.detach().cpu().double() * depth
    rows, columns = z.shape
    slope_x = (z.roll(-1, 1) - z.roll(1, 1)) * columns / 2
    slope_y = (z.roll(-1, 0) - z.roll(1, 0)) * rows / 2
    normals = torch.stack([-slope_x, -slope_y, torch.ones_like(z)], -1)
    z, normals = _closed(z), _closed(normals)
    y, x = torch.meshgrid(
        torch.linspace(0, 1, rows + 1, dtype=torch.float64),
        torch.linspace(0, 1, columns + 1, dtype=torch.float64),
        indexing="ij",
    )
    corner = (torch.arange(rows)[:, None] * (columns + 1) + torch.arange(columns)).reshape(-1)
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    # Each square is cut along the diagonal that its heights bend less along.
    flat = z.reshape(-1)
    along = ((flat[a] - flat[c]).abs() <= (flat[b] - flat[d]).abs())[:, None]
    first = torch.where(along, torch.stack([a, b, c], -1), torch.stack([a, b, d], -1))
    second = torch.where(along, torch.stack([a, c, d], -1), torch.stack([b, c, d], -1))
    return make_mesh(
        torch.stack([x, y, z], -1).reshape(-1, 3),
        torch.cat([first, second]),
        normals=normals.reshape(-1, 3),
        uv=torch.stack([x, y], -1).reshape(-1, 2),
        name=name,
    )


def read_heights(path: str | os.PathLike[str]) -> Float64[Tensor, "H W"]:
    """Heights in [0, 1] from the brightness of an image, its bottom row first: v runs up in a picture.

    The numbers of a PNG or JPEG are heights as they stand, not decoded from sRGB; so are those of an OpenEXR, which
    may leave [0, 1]. Three channels are averaged.
    Raises InputError as `light.read` does.
    Source: Sloan, Luna and Snyder 2005, section 6 (albedo mapped to height).
    """
    linear = read(path).double()
    if os.path.splitext(os.fspath(path))[1].lower() not in LINEAR:
        # The inverse of the decoding of `light.read`, IEC 61966-2-1.
        curve = 1.055 * linear.clamp(min=1e-4) ** (1 / 2.4) - 0.055
        linear = torch.where(linear <= 0.04045 / 12.92, linear * 12.92, curve)
    return linear.mean(-1).flip(0)


def tiled(mesh: Mesh, around: int = 1) -> Mesh:
    """A patch over the unit square with `around` copies of it on every side, the patch itself first.

    Raises InputError if `around` is negative, or if the patch does not fill the unit square in x and y within 1e-6:
    copies would leave gaps or overlap.
    """
    if around < 0:
        raise InputError(f"around is {around}: give 0 or more copies")
    low, high = mesh.positions[:, :2].amin(0), mesh.positions[:, :2].amax(0)
    if around and not bool(((low.abs() < 1e-6) & ((high - 1).abs() < 1e-6)).all()):
        raise InputError(
            f"{mesh.name} spans {low[0]:g} to {high[0]:g} in x and {low[1]:g} to {high[1]:g} in y: a patch that tiles "
            "must fill the unit square, scale it or bake it without tiling"
        )
    steps = range(-around, around + 1)
    shifts = sorted(((x, y) for y in steps for x in steps), key=lambda shift: shift != (0, 0))
    offset = torch.tensor([(x, y, 0) for x, y in shifts], dtype=torch.float64)
    count, vertices = len(shifts), len(mesh.positions)
    return make_mesh(
        (mesh.positions + offset[:, None]).reshape(-1, 3),
        (mesh.faces + vertices * torch.arange(count)[:, None, None]).reshape(-1, 3),
        normals=mesh.normals.repeat(count, 1),
        colours=None if mesh.colours is None else mesh.colours.repeat(count, 1),
        name=mesh.name,
    )


def _closed(values: Float[Tensor, "H W *C"]) -> Float[Tensor, "Hp Wp *C"]:
    """With the first row and column again at the end."""
    values = torch.cat([values, values[:1]], 0)
    return torch.cat([values, values[:, :1]], 1)
