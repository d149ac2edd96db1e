"""How a deformed surface has turned at every vertex, from where its vertices have gone."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.pose.gather import pick, rows_of
from torchprt.sh.precision import KeepsSingle, widened

# Normals of copies of a vertex are the same when they are rounded to this.
SAME_NORMAL = 1e-3
CANCELLED = 1e-6


def deformed_frames(
    rest: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    posed: Float[Tensor, "*B V 3"],
    *,
    normals: Float[Tensor, "V 3"] | None = None,
) -> Float[Tensor, "*B V 3 3"]:
    """The proper rotation from the rest pose to `posed` at every vertex: `DeformedFrames` for one call."""
    return DeformedFrames(rest.to(torch.promote_types(rest.dtype, posed.dtype)), faces, normals=normals)(posed)


class DeformedFrames(KeepsSingle):
    """The rotations of a mesh at its vertices; what only depends on the rest pose is done once, here.

    At a vertex the deformation gradient takes the tangent plane by the gradients of its triangles, weighted with their
    rest areas, and the rest normal to the deformed one, both area weighted. Its polar decomposition then has a closed
    form: the normal goes to the normal, and the nearest rotation within the plane is the direction of
    `A t + (A b) x n'`, for a tangent t and b = n x t. So the result is a proper rotation in every case, never a
    reflection, without iterations.

    Laws: exact for rigid motion (to rounding); equal to R F for a pose that is turned by R; the same under a uniform
    scale; gradients flow to the pose. A mirrored pose is inside out: normals follow the winding of the faces.
    Triangles that are collapsed at rest do not count. Collapsed in the pose they have no normal, and their neighbours
    decide; where the pose leaves no normal, and at a vertex without faces, the rotation is the identity. Where it
    leaves no direction in the plane (folded over itself), a tangent keeps its direction, projected.
    `normals`: of the rest pose; copies of a vertex that share place and normal (texture seams) then share their faces.

    Plain operations, no scatter: it compiles, and exports to ONNX. Rounding of positions far from the origin shows as
    it does in their differences.
    Raises InputError if a face names no vertex, or `rest` is not finite.
    Source: Sloan, Luna and Snyder 2005, section 4 (rotations by local frames); Shoemake and Duff 1992, "Matrix
    animation and polar decomposition".
    """

    single = ("rest", "basis", "slopes")
    rest: Tensor
    faces: Tensor
    basis: Tensor
    neighbours: Tensor
    own: Tensor | None
    slopes: Tensor
    around: Tensor
    still: Tensor

    def __init__(
        self, rest: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"], *, normals: Float[Tensor, "V 3"] | None = None
    ) -> None:
        super().__init__()
        count = len(rest)
        if faces.numel() and (int(faces.min()) < 0 or int(faces.max()) >= count):
            raise InputError(f"faces name vertices that the {count} of the rest pose do not have")
        if not bool(rest.isfinite().all()):
            raise InputError("rest positions hold NaN or infinity: give finite numbers")
        places, corners = rest.detach().double(), faces.long()
        edges = places[corners.roll(-1, 1)] - places[corners.roll(1, 1)]
        # A length of the mesh: squares of coordinates of 1e-30 and 1e30 then stay in the range.
        self.scale = float(edges.abs().amax()) if edges.numel() else 1.0
        self.scale = self.scale or 1.0
        edges = edges / self.scale
        across = torch.linalg.cross(edges[:, 2], edges[:, 0], dim=-1)
        length = torch.linalg.vector_norm(across, dim=-1, keepdim=True)
        unit = torch.where(length > 0, across / torch.where(length > 0, length, 1.0), 0.0)
        # x_j times n x (opposite edge), summed over the corners, is twice the gradient of x times the area.
        slopes = -torch.linalg.cross(unit[:, None].expand_as(edges), edges, dim=-1)
        vertex, face = _incident(corners, _copies(places, normals), count)
        sides, normal = _sides(across, vertex, face, count)
        still = torch.linalg.vector_norm(normal, dim=-1) == 0
        tangent, bitangent, normal = _orthonormal(normal)
        basis = torch.stack([tangent, bitangent, normal]).permute(0, 2, 1).contiguous()
        planes = torch.stack([tangent, bitangent])
        entry = torch.stack([vertex.repeat_interleave(3), corners[face].reshape(-1)])
        slope = (planes[:, entry[0]] * slopes[face].reshape(-1, 3)).sum(-1)
        # One entry for each pair of neighbours; a vertex is none of itself, as differences are taken from it.
        pairs, place = torch.unique(entry[0] * max(count, 1) + entry[1], return_inverse=True)
        slope = slope.new_zeros(2, len(pairs)).index_add_(1, place, slope)
        owner, neighbour = pairs // max(count, 1), pairs % max(count, 1)
        kept = (owner != neighbour) & (slope != 0).any(0)
        owner, neighbour, slope = owner[kept], neighbour[kept], slope[:, kept]
        wide = torch.promote_types(rest.dtype, torch.float32)
        beside, own, self.sum_neighbours = rows_of(owner, count)
        around, _, self.sum_around = rows_of(vertex, count)
        # Normals of faces, then their opposites if any counts as one, then zero.
        self.opposes = bool((sides < 0).any())
        face = torch.where(sides < 0, face + len(corners), face)
        nothing = len(corners) * (2 if self.opposes else 1)
        for name, value in (
            ("rest", rest.detach().to(wide)),
            ("still", still),
            ("faces", corners.T.reshape(-1).int()),
            ("basis", basis.to(wide)),
            ("neighbours", _filled(neighbour, beside, 0).reshape(-1).int()),
            ("own", own.int() if len(own) > count else None),
            ("slopes", _filled(slope, beside, 0).to(wide)),
            ("around", _filled(face, around, nothing).reshape(-1).int()),
        ):
            self.register_buffer(name, value, persistent=False)
        self.vertices = count

    def forward(self, posed: Float[Tensor, "*B V 3"]) -> Float[Tensor, "*B V 3 3"]:
        """Frames `[*B, V, 3, 3]` of poses `[*B, V, 3]`, in float32 at least; memory has vertices last.

        Raises InputError if there are not as many positions as vertices.
        """
        if posed.shape[-2:] != (self.vertices, 3):
            raise InputError(
                f"positions have shape {list(posed.shape)}: the rest pose has {self.vertices} vertices, give "
                f"[..., {self.vertices}, 3]"
            )
        posed = widened(posed)
        identity = torch.eye(3, dtype=posed.dtype, device=posed.device).reshape(3, 3, *(1,) * (posed.ndim - 1))
        if not len(self.faces):
            return identity.expand(3, 3, *posed.shape[:-1]).movedim((0, 1), (-2, -1))
        # Rest tangent, bitangent and normal beside poses of any batch, `[3, 3, *1, V]`.
        basis = self.basis.to(posed.dtype).reshape(3, 3, *(1,) * (posed.ndim - 2), self.vertices)
        tangent, bitangent, _ = basis.unbind(0)
        points = posed.movedim(-1, 0)
        first, second, third = pick(points, self.faces).unflatten(-1, (3, -1)).unbind(-2)
        facing = _cross((second - first) / self.scale, (third - first) / self.scale)
        zero = torch.zeros_like(facing[..., :1])
        facing = torch.cat([facing, -facing, zero] if self.opposes else [facing, zero], -1)
        around = pick(facing, self.around).unflatten(-1, (self.sum_around.width, -1))
        deformed, has_normal = _unit(self.sum_around(around))
        own = points if self.own is None else pick(points, self.own)
        near = pick(points, self.neighbours).unflatten(-1, (self.sum_neighbours.width, -1))
        apart = (near - own.unsqueeze(-2)) / self.scale
        along, across = (self.sum_neighbours(apart * slope) for slope in self.slopes.to(posed.dtype).unbind(0))
        turned, has_direction = _unit(_within(along + _cross(across, deformed), deformed))
        kept, other = _within(tangent, deformed), _within(bitangent, deformed)
        # Of two orthogonal vectors one is at least so long in any plane.
        kept, _ = _unit(torch.where((kept * kept).sum(0) > 0.25, kept, other))
        turned = torch.where(has_direction, turned, kept)
        image = torch.stack([turned, _cross(deformed, turned), deformed], 1)
        frames = torch.stack([(row.unsqueeze(1) * basis).sum(0) for row in image.unbind(0)])
        # One after another: some runtimes lack And and Not.
        moved = torch.where(has_normal, frames, identity)
        return torch.where(self.still, identity, moved).movedim((0, 1), (-2, -1))


def nearest_rotation(matrix: Float[Tensor, "*B 3 3"]) -> Float[Tensor, "*B 3 3"]:
    """The proper rotation R nearest to each matrix: largest trace of R^T matrix, the polar factor if the determinant
    is positive.

    The quaternion of R is the first eigenvector of a symmetric 4x4 matrix, found by squaring it 12 times. Exact to
    rounding where the two smallest singular values (the smallest signed as the determinant) sum to at least 2 % of the
    largest; nearer to where two rotations are equally near the result is a rotation between them, and always a proper
    one. Zero gives the identity. Gradients flow where there is one nearest rotation.
    Source: Horn 1987, "Closed-form solution of absolute orientation using unit quaternions", section 4.A.
    """
    rows = matrix.movedim((-2, -1), (0, 1)).reshape(3, 3, -1)
    largest = rows.detach().abs().amax((0, 1))
    empty = largest == 0
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rows / torch.where(empty, 1.0, largest)
    whole = torch.where(empty, 1.0, xx + yy + zz)
    power = torch.stack([
        torch.stack([whole, zy - yz, xz - zx, yx - xy]),
        torch.stack([zy - yz, xx - yy - zz, xy + yx, xz + zx]),
        torch.stack([xz - zx, xy + yx, yy - xx - zz, yz + zy]),
        torch.stack([yx - xy, xz + zx, yz + zy, zz - xx - yy]),
    ])  # fmt: skip
    # The eigenvalues sum to zero: shifted by the norm none is negative, and the first is the largest in size.
    norm = power.detach().square().sum((0, 1)).sqrt()
    power = power / norm + torch.eye(4, dtype=power.dtype, device=power.device).unsqueeze(-1)
    for _ in range(12):
        # Matrices last: four times faster than products of 4x4.
        power = (power.unsqueeze(2) * power.unsqueeze(0)).sum(1)
        power = power / (power[0, 0] + power[1, 1] + power[2, 2] + power[3, 3])
    # All columns are the eigenvector, each times one of its numbers.
    best = torch.stack([power[axis, axis] for axis in range(4)]).argmax(0)
    column = power.gather(1, best.expand(4, 1, -1))[:, 0]
    w, x, y, z = column / torch.sqrt((column * column).sum(0))
    turned = torch.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ])  # fmt: skip
    return turned.reshape(3, 3, *matrix.shape[:-2]).movedim((0, 1), (-2, -1))


def _copies(places: Tensor, normals: Tensor | None) -> Tensor:
    """For every vertex a number that it shares with those at the same place with the same normal."""
    if normals is None or not len(places):
        return torch.arange(len(places), device=places.device)
    rounded = (normals.detach().double() / SAME_NORMAL).round()
    group = torch.zeros(len(places), dtype=torch.int64, device=places.device)
    for column in torch.cat([places, rounded], 1).unbind(1):
        # Column by column: twenty times faster than unique rows.
        group = group * len(places) + torch.unique(column, return_inverse=True)[1]
        group = torch.unique(group, return_inverse=True)[1]
    return group


def _incident(corners: Tensor, group: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Vertices, ascending, and their faces: those that name them or a copy."""
    face = torch.arange(len(corners), device=corners.device).repeat_interleave(3)
    order = group[corners.reshape(-1)].argsort(stable=True)
    degree = torch.bincount(group[corners.reshape(-1)], minlength=count)
    first = degree.cumsum(0) - degree
    many = degree[group]
    vertex = torch.arange(count, device=corners.device).repeat_interleave(many)
    place = torch.arange(len(vertex), device=corners.device) - (many.cumsum(0) - many)[vertex]
    return vertex, face[order][first[group[vertex]] + place]


def _sides(across: Tensor, vertex: Tensor, face: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """What the normal of a face counts at a vertex, 1 or -1, and the normal of the vertex, zero if it has none.

    Faces that cancel each other, as those of a sheet with both windings, all count on the side of one of them.
    """

    def total(sign: Tensor) -> tuple[Tensor, Tensor]:
        normals = across.new_zeros(count, 3).index_add_(0, vertex, across[face] * sign[:, None])
        size = torch.linalg.vector_norm(normals, dim=-1)
        return normals, size <= CANCELLED * areas

    areas = across.new_zeros(count).index_add_(0, vertex, torch.linalg.vector_norm(across, dim=-1)[face])
    sign = across.new_ones(len(vertex))
    normals, lost = total(sign)
    if bool((lost & (areas > 0)).any()):
        largest = across.new_zeros(count, 3).index_copy_(0, vertex, across[face])
        opposed = (largest[vertex] * across[face]).sum(-1) < 0
        sign = torch.where(lost[vertex] & opposed, -1.0, sign)
        normals, lost = total(sign)
    return sign, normals.masked_fill(lost[:, None], 0)


def _orthonormal(normal: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Unit tangent, bitangent and normal `[V, 3]`; of the world where the normal is zero."""
    length = torch.linalg.vector_norm(normal, dim=-1, keepdim=True)
    pole = torch.tensor([0.0, 0.0, 1.0], dtype=normal.dtype, device=normal.device)
    normal = torch.where(length > 0, normal / torch.where(length > 0, length, 1.0), pole)
    far = torch.nn.functional.one_hot(normal.abs().argmin(-1), 3).to(normal.dtype)
    tangent = torch.linalg.cross(far, normal, dim=-1)
    tangent = tangent / torch.linalg.vector_norm(tangent, dim=-1, keepdim=True)
    return tangent, torch.linalg.cross(normal, tangent, dim=-1), normal


def _filled(values: Tensor, rows: Tensor, empty: int) -> Tensor:
    """`values [..., E]` in the slots `rows [W, R]`, `empty` where a slot is E."""
    return torch.cat([values, values.new_full((*values.shape[:-1], 1), empty)], -1)[..., rows].contiguous()


def _cross(a: Tensor, b: Tensor) -> Tensor:
    (ax, ay, az), (bx, by, bz) = a.unbind(0), b.unbind(0)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _within(vector: Tensor, normal: Tensor) -> Tensor:
    """What is left of a vector in the plane of a unit normal."""
    return vector - normal * (vector * normal).sum(0)


def _unit(vector: Tensor) -> tuple[Tensor, Tensor]:
    """Vectors `[3, ...]` at unit length, and which have a direction; zero and finite gradients where they have none."""
    x, y, z = vector.detach().abs().unbind(0)
    largest = torch.maximum(torch.maximum(x, y), z)
    found = largest > 0
    scaled = torch.where(found, vector, 0.0) / torch.where(found, largest, 1.0)
    squared = (scaled * scaled).sum(0)
    return scaled / torch.sqrt(torch.where(found, squared, 1.0)), found
