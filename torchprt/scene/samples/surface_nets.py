"""Triangles on the zero level of a function: naive surface nets, relaxed on the surface."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from torch import Tensor

Field = Callable[[Float[Tensor, "P 3"]], Float[Tensor, "P"]]
"""Signed distance, or less: negative inside, changing by no more than the distance moved."""

BLOCK = 4
"""Cells along the side of a block that is skipped if the surface cannot reach it."""


def surface_nets(
    field: Field, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], cell: float, relaxations: int = 3
) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "F 3"]]:
    """Positions and faces (counter-clockwise from outside) where `field` is zero within the box.

    One vertex in every cell that the surface crosses; then `relaxations` rounds of moving each vertex toward the
    middle of its neighbours and back onto the surface, which makes the triangles well shaped.
    Source: Gibson 1998, "Constrained elastic surface nets".
    """
    values = _parted(_sample(field, low, high, cell), cell)
    positions, faces = _net(values)
    points = torch.from_numpy(low + cell * positions)
    for _ in range(relaxations):
        points = _onto(field, _averaged(points, faces).float()).double()
    return points.numpy(), _split(points.numpy(), faces)


def _sample(
    field: Field, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], cell: float
) -> Float[np.ndarray, "X Y Z"]:
    """The field at the corners of cells; where the surface cannot be near, only its sign is right."""
    blocks = np.ceil((high - low) / (cell * BLOCK)).astype(int)
    centre = np.stack(np.meshgrid(*[np.arange(n) + 0.5 for n in blocks], indexing="ij"), axis=-1)
    with torch.no_grad():
        middle = field(torch.from_numpy(low + centre.reshape(-1, 3) * cell * BLOCK).float()).numpy()
    near = (np.abs(middle) <= 0.5 * BLOCK * cell * 3**0.5 + cell).reshape(blocks)

    def spread(array: np.ndarray) -> np.ndarray:
        for axis in range(3):
            array = np.repeat(array, BLOCK, axis=axis)
        return np.pad(array, [(0, 1)] * 3, mode="edge")

    values = spread(middle.reshape(blocks)).astype(np.float64)
    wanted = spread(near)
    # A corner on the face between two blocks is wanted if either of them is.
    for axis in range(3):
        shifted = np.roll(wanted, 1, axis=axis)
        wanted |= shifted
    corners = np.argwhere(wanted)
    with torch.no_grad():
        values[wanted] = field(torch.from_numpy(low + corners * cell).float()).double().numpy()
    return values


def _parted(values: Float[np.ndarray, "X Y Z"], cell: float) -> Float[np.ndarray, "X Y Z"]:
    """Values changed where two sheets share a cell, so that one vertex a cell makes a manifold: the gap is filled."""
    values = values.copy()
    shared = _shared_cases()
    corners = [np.array(corner) for corner in np.ndindex(2, 2, 2)]
    while True:
        inside = values < 0
        case = np.zeros(tuple(n - 1 for n in values.shape), dtype=np.uint8)
        for bit, (i, j, k) in enumerate(corners):
            x, y, z = case.shape
            case |= inside[i : i + x, j : j + y, k : k + z].astype(np.uint8) << bit
        at = np.argwhere(shared[case])
        if not len(at):
            return values
        for corner in corners:
            where = tuple((at + corner).T)
            values[where] = np.where(values[where] >= 0, -1e-3 * cell, values[where])


def _shared_cases() -> np.ndarray:
    """For each of the 256 ways the corners of a cell lie inside, whether the inside or the outside is in pieces."""
    corners = list(np.ndindex(2, 2, 2))
    joined = np.array([[sum(a != b for a, b in zip(p, q, strict=True)) == 1 for q in corners] for p in corners])

    def pieces(members: list[int]) -> int:
        left, count = set(members), 0
        while left:
            count += 1
            reached = [left.pop()]
            while reached:
                here = reached.pop()
                near = {other for other in left if joined[here, other]}
                left -= near
                reached += near
        return count

    sides = [
        ([b for b in range(8) if case >> b & 1], [b for b in range(8) if not case >> b & 1]) for case in range(256)
    ]
    return np.array([pieces(within) > 1 or pieces(without) > 1 for within, without in sides])


def _net(values: Float[np.ndarray, "X Y Z"]) -> tuple[Float[np.ndarray, "V 3"], Int[np.ndarray, "Q 4"]]:
    """Vertices in units of cells and quadrilaterals, one around every grid edge that the surface crosses."""
    inside = values < 0
    cells = tuple(n - 1 for n in values.shape)
    total = np.zeros((*cells, 3))
    count = np.zeros(cells)
    crossings = []
    for axis in range(3):
        here, there = _slices(axis)
        crossed = np.argwhere(inside[here] != inside[there])
        a = values[tuple(crossed.T)]
        step = np.eye(3, dtype=int)[axis]
        b = values[tuple((crossed + step).T)]
        point = crossed + step * (a / (a - b))[:, None]
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        around = [crossed - u - v, crossed - v, crossed, crossed - u]
        for neighbour in around:
            np.add.at(total, tuple(neighbour.T), point)
            np.add.at(count, tuple(neighbour.T), 1)
        crossings.append((around, inside[tuple(crossed.T)]))
    number = np.full(cells, -1)
    used = count > 0
    number[used] = np.arange(used.sum())
    quads = []
    for around, outward in crossings:
        quad = np.stack([number[tuple(neighbour.T)] for neighbour in around], axis=1)
        quads.append(np.where(outward[:, None], quad, quad[:, ::-1]))
    return total[used] / count[used][:, None], np.concatenate(quads)


def _slices(axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    here, there = [slice(None)] * 3, [slice(None)] * 3
    here[axis], there[axis] = slice(None, -1), slice(1, None)
    return tuple(here), tuple(there)


def _averaged(points: Float64[Tensor, "V 3"], quads: Int[np.ndarray, "Q 4"]) -> Float64[Tensor, "V 3"]:
    """Every vertex half way to the middle of its neighbours along the sides of the quadrilaterals."""
    corner = torch.from_numpy(np.ascontiguousarray(quads))
    neighbours = torch.zeros_like(points)
    count = torch.zeros(len(points), 1, dtype=points.dtype)
    for side in range(4):
        one, other = corner[:, side], corner[:, (side + 1) % 4]
        neighbours.index_add_(0, one, points[other])
        count.index_add_(0, one, torch.ones(len(one), 1, dtype=points.dtype))
    return 0.5 * points + 0.5 * neighbours / count


@torch.inference_mode(False)
@torch.enable_grad()
def _onto(field: Field, points: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3"]:
    """Points moved along the gradient to where the field is zero (one Newton step)."""
    moved = points.clone().requires_grad_(True)
    value = field(moved)
    (slope,) = torch.autograd.grad(value.sum(), moved)
    return (moved - slope * (value / slope.square().sum(dim=1).clamp_min(0.05))[:, None]).detach()


def _split(points: Float[np.ndarray, "V 3"], quads: Int[np.ndarray, "Q 4"]) -> Int[np.ndarray, "F 3"]:
    """Each quadrilateral as two triangles, along its shorter diagonal."""
    a, b, c, d = quads.T
    straight = np.linalg.norm(points[a] - points[c], axis=1) <= np.linalg.norm(points[b] - points[d], axis=1)
    first = np.where(straight[:, None], np.stack([a, b, c], 1), np.stack([a, b, d], 1))
    second = np.where(straight[:, None], np.stack([a, c, d], 1), np.stack([b, c, d], 1))
    return np.stack([first, second], axis=1).reshape(-1, 3)
