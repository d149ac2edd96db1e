"""Normals where the file has none."""

import numpy as np
from jaxtyping import Float, Int

from .weld import edges, weld

CREASE_COSINE = 0.5
"""Two faces that share an edge are one smooth surface if their normals are within 60 degrees of each other."""

CANCELLED = 1e-6
"""A sum of face normals this small beside the sum of its weights has no direction: the faces oppose each other."""


def face_normals(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """Unit normals of faces, counter-clockwise seen from outside; zero for a face without area."""
    corners = positions[faces]
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    # Edges are scaled to about one before the product: squares of 1e-170 would underflow.
    size = np.maximum(np.abs(first).max(axis=1), np.abs(second).max(axis=1))[:, None]
    size = np.where(size > 0, size, 1.0)
    return unit(np.cross(first / size, second / size))


def unit(vectors: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "V 3"]:
    """Vectors at unit length; zero where a vector is zero or not finite."""
    finite = np.isfinite(vectors).all(axis=1)
    x, y, z = np.abs(np.where(finite[:, None], vectors, 0.0)).T
    largest = np.maximum(np.maximum(x, y), z)
    usable = largest > 0
    scaled = np.where(usable[:, None], vectors, 0.0) / np.where(usable, largest, 1.0)[:, None]
    length = _length(scaled)
    return scaled / np.where(usable, length, 1.0)[:, None]


def _length(vectors: Float[np.ndarray, "*rows 3"]) -> Float[np.ndarray, "*rows"]:
    # Half the time of numpy's norm on short rows; the callers keep squares in range.
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def corner_angles(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
    """The angle of every face at each of its corners, in radians."""
    corners = positions[faces]
    ahead = np.stack([unit(corners[:, (j + 1) % 3] - corners[:, j]) for j in range(3)], axis=1)
    back = -np.roll(ahead, 1, axis=1)
    # The arc tangent of both lengths is exact for slivers, where the arc cosine is not (Kahan).
    return 2 * np.arctan2(_length(ahead - back), _length(ahead + back))


def vertex_normals(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Float[np.ndarray, "V 3"]:
    """Unit normals of vertices from their faces, weighted by the angle of each face at the vertex.

    A vertex averages all faces that name it. Where a mesh repeats a position (texture seams, STL), the copies
    also share the faces that follow over edges bent by less than 60 degrees, so a seam does not show
    and the sides of a box stay flat.
    A vertex gets zero if no face names it, or if its faces have no area or cancel each other.
    Source: Thürmer and Wüthrich 1998, "Computing vertex normals from polygonal facets".
    """
    if not len(faces):
        return np.zeros_like(positions)
    normals = face_normals(positions, faces)
    # A face without area has no direction to give.
    weights = corner_angles(positions, faces) * np.any(normals != 0, axis=1)[:, None]
    patch = _smooth_patches(positions, faces, normals)
    patches = int(patch.max(initial=-1)) + 1
    flat = weights.ravel()
    total = np.stack([np.bincount(patch, flat * np.repeat(normals[:, k], 3), patches) for k in range(3)], axis=1)
    weight = np.bincount(patch, flat, patches)
    usable = _length(total) > CANCELLED * weight
    smooth = unit(np.where(usable[:, None], total, 0.0))
    result = np.zeros_like(positions)
    result[faces.ravel()] = smooth[patch]
    return result


def _smooth_patches(
    positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], normals: Float[np.ndarray, "F 3"]
) -> Int[np.ndarray, "corners"]:
    """For every corner of every face, the number of the smooth patch that it and its neighbours form."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    vertices = len(positions)
    place = weld(positions)
    if place.max(initial=-1) + 1 == vertices:
        return faces.ravel()
    welded = place[faces]
    sides = edges(welded)
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
    return patch.astype(np.int64)[faces.ravel()]
