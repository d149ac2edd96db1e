"""Normals where the file has none."""

import numpy as np
from jaxtyping import Float, Int

from .columns import blocks, corner_columns, cross, largest, length, unit_columns, zero_rows
from .weld import Joined, join

CREASE_COSINE = 0.5
"""Two faces that share an edge are one smooth surface if their normals are within 60 degrees of each other."""

CANCELLED = 1e-6
"""A sum of face normals this small beside the sum of its weights has no direction: the faces oppose each other."""


def face_normals(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Unit normals of faces, counter-clockwise seen from outside; zero for a face without area."""
    result = np.empty((len(faces), 3))
    for rows in blocks(len(faces)):
        corners = corner_columns(positions, faces[rows])
        first, second = corners[1] - corners[0], corners[2] - corners[0]
        # Edges are scaled to about one before the product: squares of 1e-170 would underflow.
        size = np.maximum(largest(first), largest(second))
        size = np.where(size > 0, size, 1.0)
        result[rows] = unit_columns(cross(first / size, second / size)).T
    return result


def unit(vectors: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Vectors at unit length; zero where a vector is zero or not finite."""
    result = np.empty(vectors.shape)
    for rows in blocks(len(vectors)):
        result[rows] = unit_columns(np.ascontiguousarray(vectors[rows].T)).T
    return result


def corner_angles(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """The angle of every face at each of its corners, in radians."""
    result = np.empty((len(faces), 3))
    for rows in blocks(len(faces)):
        corners = corner_columns(positions, faces[rows])
        ahead = [unit_columns(corners[(j + 1) % 3] - corners[j]) for j in range(3)]
        for j in range(3):
            back = -ahead[j - 1]
            # The arc tangent of both lengths is exact for slivers, where the arc cosine is not (Kahan).
            result[rows, j] = 2 * np.arctan2(length(ahead[j] - back), length(ahead[j] + back))
    return result


def vertex_normals(
    positions: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    joined: Joined | None = None,
) -> Float[np.ndarray, "V 3"]:
    """Unit normals of vertices from their faces, weighted by the angle of each face at the vertex.

    A vertex averages all faces that name it. Where a mesh repeats a position (texture seams, STL), the copies
    also share the faces that follow over edges bent by less than 60 degrees, so a seam does not show
    and the sides of a box stay flat.
    A vertex gets zero if no face names it, or if its faces have no area or cancel each other.
    `joined` is `join(positions, faces)` if it is at hand.
    Source: Thürmer and Wüthrich 1998, "Computing vertex normals from polygonal facets".
    """
    if not len(faces):
        return np.zeros_like(positions)
    normals = face_normals(positions, faces)
    # A face without area has no direction to give.
    weights = corner_angles(positions, faces) * ~zero_rows(normals)[:, None]
    patch = _smooth_patches(faces, normals, join(positions, faces) if joined is None else joined)
    number = faces.ravel() if patch is None else patch[faces.ravel()]
    patches = int(number.max(initial=-1)) + 1
    total = np.stack([np.bincount(number, (weights * normals[:, k, None]).ravel(), patches) for k in range(3)], axis=1)
    weight = np.bincount(number, weights.ravel(), patches)
    usable = length(total.T) > CANCELLED * weight
    smooth = unit(np.where(usable[:, None], total, 0.0))
    result = np.zeros_like(positions)
    if patch is None:
        result[:patches] = smooth
    else:
        named = np.zeros(len(positions), dtype=bool)
        named[faces.ravel()] = True
        result[named] = smooth[patch[named]]
    return result


def _smooth_patches(
    faces: Int[np.ndarray, "F 3"], normals: Float[np.ndarray, "F 3"], joined: Joined
) -> Int[np.ndarray, "V"] | None:
    """For every vertex the number of the smooth patch that it and its copies form; None if nothing is repeated."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not joined.repeated:
        return None
    vertices, sides = len(joined.place), joined.edges
    inner = sides.start[sides.count == 2]
    one, other = inner, inner + 1
    bent = np.einsum("ij,ij->i", normals[sides.face[one]], normals[sides.face[other]]) < CREASE_COSINE
    # Faces that run along their shared edge in one direction are wound inconsistently: not one surface.
    joined = ~bent & (sides.forward[one] != sides.forward[other])
    one, other = one[joined], other[joined]

    def corner(edge: np.ndarray, end: int) -> np.ndarray:
        return faces[sides.face[edge], (sides.side[edge] + end) % 3]

    links_from = np.concatenate([corner(one, 0), corner(one, 1)])
    links_to = np.concatenate([corner(other, 1), corner(other, 0)])
    graph = coo_matrix((np.ones(len(links_from), dtype=bool), (links_from, links_to)), (vertices, vertices))
    _, patch = connected_components(graph, directed=False)
    return patch.astype(np.int64)
