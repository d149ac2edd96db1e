"""Tangents of vertices: along u where a mesh has texture coordinates, else a field that turns as little as it can.

A tangent fixes the local frame of a vertex: tangent, bitangent = normal x tangent, normal. Glossy transfer is stored
in it, so tangents must not jump from a vertex to the next: neighbours would then share nothing to compress. Frames
computed from the normal alone (Frisvad 2012; Duff et al. 2017) spin about one pole, in the flat base of a scan, say.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from .normals import corner_angles, unit
from .weld import weld

if TYPE_CHECKING:
    import scipy.sparse

REACH = 1000.0
"""Weight of smoothness beside the guide: a round of diffusion reaches as far as its square root, in edges."""

ROUNDS = 3
"""Rounds of diffusion, each guided by the directions that the last one found."""

SOLVED = 1e-6
"""Relative residual at which a round is solved."""

CANCELLED = 1e-6
"""A sum of tangents this small beside the sum of its weights has no direction."""

COLLINEAR = 1e-9
"""A face whose texture coordinates span this little area, beside the square of their extent, gives no tangent."""


def tangents_from_uv(
    positions: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "V 3"],
    uv: Float[np.ndarray, "F 3 2"],
) -> Float[np.ndarray, "V 3"]:
    """Unit tangents of vertices in the direction of increasing u, orthogonal to their normals.

    `uv` is given for every corner of every face, so a seam where u begins anew does not show. A vertex averages its
    faces by their angle at it. Where u runs the other way round (mirrored texture coordinates) the tangent follows
    u; the bitangent is always normal x tangent, and does not follow v.
    Zero where the coordinates give no direction: missing (not finite), collapsed or cancelling, or no normal.
    The same for positions and for coordinates at any scale and place, up to rounding.
    Source: Lengyel 2001, "Computing tangent space basis vectors for an arbitrary mesh".
    """
    finite = np.isfinite(uv).reshape(-1, 6).all(axis=1)
    map_sides = _scaled(np.where(finite[:, None, None], uv, 0.0))
    sides = _scaled(positions[faces])
    (u1, v1), (u2, v2) = map_sides[:, 0].T, map_sides[:, 1].T
    area = u1 * v2 - u2 * v1
    along = unit(np.sign(area)[:, None] * (v2[:, None] * sides[:, 0] - v1[:, None] * sides[:, 1]))
    along[np.abs(area) <= COLLINEAR] = 0.0
    weights = corner_angles(positions, faces) * np.any(along != 0, axis=1)[:, None]
    vertices, flat = len(positions), weights.ravel()
    corner = faces.ravel()
    total = np.stack([np.bincount(corner, flat * np.repeat(along[:, k], 3), vertices) for k in range(3)], axis=1)
    total = _tangential(total, normals)
    usable = np.linalg.norm(total, axis=1) > CANCELLED * np.bincount(corner, flat, vertices)
    usable &= np.any(normals != 0, axis=1)
    return orthogonal(unit(np.where(usable[:, None], total, 0.0)), normals)


def smooth_tangents(
    positions: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "V 3"],
    guide: Float[np.ndarray, "V 3"] | None = None,
) -> Float[np.ndarray, "V 3"]:
    """A unit tangent for every vertex, turning little from neighbour to neighbour and orthogonal to the normals.

    Every connected piece is guided by a world axis, x unless its normals are mostly along it, projected to its tangent
    planes: (D + t L) z = D g is solved, g the guide, L the connection Laplacian of the edges, D their sum at each
    vertex, t = 1000; then twice more with g the unit directions of the last solution. Rows of `guide` that are not
    zero are kept (made orthogonal to the normal, unit) and flow into the others. Where a closed surface forces it
    (any but a torus) the field has poles.
    Vertices at one position are joined; with equal normals too they get one tangent. A vertex with a zero normal gets
    a unit tangent, any.
    Depends on the normals and on which vertices are neighbours, on nothing else: so on neither scale nor place. The
    same bits for any number of threads.
    Source: Knöppel et al. 2013, "Globally optimal direction fields", sections 4 and 5 (alignment to a guide).
    """
    lit = np.any(normals != 0, axis=1)
    normals = np.where(lit[:, None], normals, [0.0, 0.0, 1.0])
    guide = np.zeros_like(normals) if guide is None else orthogonal(guide, normals)
    guide = np.where(lit[:, None], guide, 0.0)
    place = weld(positions)
    # Copies with the same normal are one node, whatever the seam between them is for.
    sample, node = np.unique(place * len(place) + weld(normals), return_index=True, return_inverse=True)[1:]
    means = np.stack([np.bincount(node, guide[:, k], len(sample)) for k in range(3)], axis=1)
    field = _field(place[sample], node[faces], normals[sample], lit[sample], orthogonal(means, normals[sample]))
    return orthogonal(np.where(np.any(guide != 0, axis=1)[:, None], guide, field[node]), normals)


def _field(
    place: Int[np.ndarray, "V"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "V 3"],
    lit: Bool[np.ndarray, "V"],
    guide: Float[np.ndarray, "V 3"],
) -> Float[np.ndarray, "V 3"]:
    """The field over nodes at places, none of whose normals is zero; those that are not `lit` stay by themselves."""
    first, second = _bases(normals)
    kept = np.any(guide != 0, axis=1)
    one, other = _neighbours(place, faces)
    # Neighbours back to back have no shared direction: the weight fades before transport fails.
    weight = 0.5 * (1 + np.einsum("ij,ij->i", normals[one], normals[other])) * (lit[one] & lit[other])
    near = weight > 1e-3
    one, other, weight = one[near], other[near], weight[near]
    aim = np.where(kept[:, None], guide, _axes(normals, one, other))
    start = np.einsum("ij,ij->i", aim, first) + 1j * np.einsum("ij,ij->i", aim, second)
    angle = _diffused(start, kept, _transport(normals, first, second, one, other, weight))
    return angle.real[:, None] * first + angle.imag[:, None] * second


def orthogonal(vectors: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Unit vectors, less their part along the normals; zero where next to nothing is left, or without a normal."""
    vectors = unit(vectors)
    flat = _tangential(vectors, normals)
    usable = (np.linalg.norm(flat, axis=1) > CANCELLED) & np.any(normals != 0, axis=1)
    # Once more at unit length: rounding left a part along the normal, large beside what little may have remained.
    return unit(_tangential(unit(np.where(usable[:, None], flat, 0.0)), normals))


def _scaled(corners: Float[np.ndarray, "F 3 d"]) -> Float[np.ndarray, "F 2 d"]:
    """The two sides of triangles from their first corner, scaled to about one so that no product underflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        sides = corners[:, 1:] - corners[:, :1]
    size = np.abs(sides).reshape(len(sides), -1).max(axis=1, initial=0.0)
    usable = (size > 0) & np.isfinite(size)
    return np.where(usable[:, None, None], sides, 0.0) / np.where(usable, size, 1.0)[:, None, None]


def _tangential(vectors: Float[np.ndarray, "V 3"], normals: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    return vectors - np.einsum("ij,ij->i", vectors, normals)[:, None] * normals


def _bases(normals: Float[np.ndarray, "V 3"]) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "V 3"]]:
    """Two directions that make a right-handed frame with each normal. Source: Duff et al. 2017, listing 3."""
    x, y, z = normals.T
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    return np.stack([1 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)


def _neighbours(
    place: Int[np.ndarray, "V"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Int[np.ndarray, "E"], Int[np.ndarray, "E"]]:
    """Pairs of nodes that share an edge of a face or follow each other at a place, each pair once."""
    vertices = len(place)
    order = np.argsort(place, kind="stable")
    copies = place[order[1:]] == place[order[:-1]]
    tail = np.concatenate([faces.ravel(), order[:-1][copies]])
    head = np.concatenate([np.roll(faces, -1, axis=1).ravel(), order[1:][copies]])
    real = tail != head
    low, high = np.minimum(tail, head)[real], np.maximum(tail, head)[real]
    key = np.unique(low * vertices + high)
    return key // vertices, key % vertices


def _axes(
    normals: Float[np.ndarray, "V 3"], one: Int[np.ndarray, "E"], other: Int[np.ndarray, "E"]
) -> Float[np.ndarray, "V 3"]:
    """For every vertex the world axis that guides its connected piece: the one least along its normals."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    vertices = len(normals)
    graph = coo_matrix((np.ones(len(one), dtype=bool), (one, other)), (vertices, vertices))
    pieces, piece = connected_components(graph, directed=False)
    along = np.stack([np.bincount(piece, normals[:, k] ** 2, pieces) for k in range(3)], axis=1)
    # x is taken unless another is clearly better: rounding must not decide.
    return np.eye(3)[(along * [0.5, 1.0, 1.0]).argmin(axis=1)][piece]


def _transport(
    normals: Float[np.ndarray, "V 3"],
    first: Float[np.ndarray, "V 3"],
    second: Float[np.ndarray, "V 3"],
    one: Int[np.ndarray, "E"],
    other: Int[np.ndarray, "E"],
    weight: Float[np.ndarray, "E"],
) -> "scipy.sparse.csr_matrix":
    """Hermitian [V, V]: entry (i, j) takes a tangent at j, as a complex number, to i by the least rotation of normals.

    Times the weight of the edge.
    """
    from scipy.sparse import csr_matrix

    middle = normals[one] + normals[other]
    along = np.einsum("ij,ij->i", normals[one], first[other]) / (2 * weight)
    moved = first[other] - along[:, None] * middle
    turn = np.einsum("ij,ij->i", moved, first[one]) + 1j * np.einsum("ij,ij->i", moved, second[one])
    entries = np.concatenate([weight * turn, weight * turn.conj()])
    places = (np.concatenate([one, other]), np.concatenate([other, one]))
    return csr_matrix((entries, places), shape=(len(normals), len(normals)))


def _diffused(
    guide: Complex[np.ndarray, "V"], kept: Bool[np.ndarray, "V"], transport: "scipy.sparse.csr_matrix"
) -> Complex[np.ndarray, "V"]:
    """Unit complex numbers that follow the guide and turn little; kept ones are those of the guide."""
    degree = np.asarray(abs(transport).sum(axis=1)).ravel()
    alone = degree == 0
    # A kept direction is a wall, so its weight is beyond any that its neighbours have together.
    hold = np.where(alone, 1.0, degree) * np.where(kept, 1e6 * REACH, 1.0)
    diagonal = hold + REACH * degree
    solution = guide
    for _ in range(ROUNDS):
        solution = _solved(transport, diagonal, hold * guide, solution)
        guide = np.where(kept, guide, _direction(solution))
    return guide


def _direction(values: Complex[np.ndarray, "V"]) -> Complex[np.ndarray, "V"]:
    size = np.abs(values)
    return np.where(size > 0, values / np.where(size > 0, size, 1.0), 1.0)


def _solved(
    transport: "scipy.sparse.csr_matrix",
    diagonal: Float[np.ndarray, "V"],
    wanted: Complex[np.ndarray, "V"],
    start: Complex[np.ndarray, "V"],
) -> Complex[np.ndarray, "V"]:
    """z where diagonal z - REACH transport z = wanted, by conjugate gradients preconditioned with the diagonal.

    No sum goes through BLAS, whose order of summing depends on the number of threads.
    """

    def dot(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.einsum("i,i->", a.conj(), b).real)

    def apply(z: np.ndarray) -> np.ndarray:
        return diagonal * z - REACH * (transport @ z)

    z = start
    left = wanted - apply(z)
    enough = SOLVED**2 * dot(wanted, wanted / diagonal)
    step = left / diagonal
    size = dot(left, step)
    for _ in range(5000):
        if size <= enough:
            break
        moved = apply(step)
        length = size / dot(step, moved)
        z = z + length * step
        left = left - length * moved
        next_size = dot(left, left / diagonal)
        step = left / diagonal + (next_size / size) * step
        size = next_size
    return z
