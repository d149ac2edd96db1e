"""What is in a mesh, and what is wrong with it, in sentences."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from torchprt.words import count

from .columns import blocks, corner_columns, cross, largest, length, zero_rows
from .weld import Joined, join

FLAT = 1e-7
"""A face is degenerate if its height is at most this share of its longest side: below what float32 resolves."""


@dataclass(frozen=True)
class MeshReport:
    """What was found in a mesh. Nothing is repaired silently: `str(report)` says all of it.

    Edges are judged between positions, not vertices: a seam, where vertices are repeated, is not a hole.
    """

    vertices: int
    faces: int
    components: int
    """Connected pieces of surface."""
    extent: tuple[float, float, float]
    """Size of the bounding box along x, y and z."""
    boundary_edges: int
    """Edges of one face: the surface is open there, and light enters."""
    nonmanifold_edges: int
    """Edges of more than two faces."""
    flipped_edges: int
    """Edges whose two faces are wound in opposite senses: one of them shows its inside."""
    degenerate_faces: int
    duplicate_vertices: int
    """Vertices at the position of an earlier vertex."""
    unreferenced_vertices: int
    computed_normals: int
    """Vertices whose normal was computed from the faces, because the file has none or an unusable one."""
    missing_normals: int
    """Vertices without any usable normal. A bake turns those that faces name, or fills them from their neighbours."""
    opposed_normals: int
    """Vertices whose normal in the file points to the back of their faces."""
    inside_out: bool = False
    """Closed, but all faces turn their backs outward: right for a room seen from within, and for nothing else."""
    missing_tangents: int = 0
    """Vertices that the file's tangents or texture coordinates, if it has any, give no direction."""
    dark_vertices: int = 0
    """Those without a usable normal that no face names either: they receive no light."""
    notes: tuple[str, ...] = ()
    """What the file holds beside, in sentences."""

    @property
    def watertight(self) -> bool:
        """Whether every edge joins two faces of the same sense, so that the surface has an inside."""
        return not (self.boundary_edges or self.nonmanifold_edges or self.flipped_edges)

    def __str__(self) -> str:
        pieces = count(self.components, "piece")
        lines = [
            f"{count(self.vertices, 'vertex')}, {count(self.faces, 'face')} in {pieces}, "
            "extent " + " x ".join(f"{length:.6g}" for length in self.extent) + "."
        ]
        if self.watertight:
            lines.append("The surface is closed and consistently wound.")
        if self.inside_out:
            lines.append("It is inside out: faces turn their backs outward, which block light and reflect none.")
        if self.boundary_edges:
            lines.append(f"{count(self.boundary_edges, 'edge')} with one face: the surface is open there.")
        if self.nonmanifold_edges:
            lines.append(f"{count(self.nonmanifold_edges, 'edge')} with more than two faces.")
        if self.flipped_edges:
            lines.append(f"{count(self.flipped_edges, 'edge')} between faces wound in opposite senses.")
        if self.degenerate_faces:
            lines.append(f"{count(self.degenerate_faces, 'face')} without area: kept.")
        if self.duplicate_vertices:
            lines.append(f"{count(self.duplicate_vertices, 'vertex')} at the position of another: kept.")
        if self.unreferenced_vertices:
            lines.append(f"{count(self.unreferenced_vertices, 'vertex')} named by no face: kept.")
        if self.computed_normals:
            lines.append(f"{count(self.computed_normals, 'normal')} computed from the faces.")
        if self.opposed_normals:
            lines.append(f"{count(self.opposed_normals, 'normal')} pointing to the back of the faces: kept.")
        if seen := self.missing_normals - self.dark_vertices:
            lines.append(
                f"{count(seen, 'vertex')} of faces without a usable normal: turned or filled by a bake, "
                "unless it is raw or unshadowed."
            )
        if self.dark_vertices:
            lines.append(f"{count(self.dark_vertices, 'vertex')} of no face and no normal: will receive no light.")
        if self.missing_tangents:
            lines.append(
                f"{count(self.missing_tangents, 'vertex')} whose texture coordinates give no tangent: "
                "glossy surfaces take a smooth field there."
            )
        return "\n".join([*lines, *self.notes])


def check(
    positions: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "V 3"],
    computed: Bool[np.ndarray, "V"],
    from_faces: Float[np.ndarray, "V 3"],
    joined: Joined | None = None,
) -> MeshReport:
    """The report of a mesh whose vertices `computed` took their normals `from_faces`.

    `joined` is `join(positions, faces)` if it is at hand.

    The verdict is the same for the mesh at any scale and place, up to the rounding of its coordinates.
    """
    joined = join(positions, faces) if joined is None else joined
    sides = joined.edges
    pairs = sides.start[sides.count == 2]
    flipped = int((sides.forward[pairs] == sides.forward[pairs + 1]).sum())
    missing = zero_rows(normals)
    referenced = np.zeros(len(positions), dtype=bool)
    referenced[faces.ravel()] = True
    extent = np.ptp(positions, axis=0)
    closed = len(pairs) == len(sides.count) and not flipped
    return MeshReport(
        vertices=len(positions),
        faces=len(faces),
        components=_components(joined.faces),
        extent=(float(extent[0]), float(extent[1]), float(extent[2])),
        boundary_edges=int((sides.count == 1).sum()),
        nonmanifold_edges=int((sides.count > 2).sum()),
        flipped_edges=flipped,
        degenerate_faces=int(degenerate(positions, faces).sum()),
        duplicate_vertices=joined.repeated,
        unreferenced_vertices=int((~referenced).sum()),
        computed_normals=int((computed & ~missing).sum()),
        missing_normals=int(missing.sum()),
        dark_vertices=int((~referenced & missing).sum()),
        opposed_normals=int((np.einsum("ij,ij->i", normals, from_faces) < 0).sum()),
        # A sheet with two sides encloses nothing, up to the rounding of the sum.
        inside_out=closed and _volume(positions, faces) < -1e-9,
    )


def _volume(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    """Enclosed volume of a closed surface whose extent is 1, negative if the backs of its faces are outside."""
    size = float(np.ptp(positions, axis=0).max()) or 1.0
    middle = positions.mean(axis=0)[:, None]
    total = 0.0
    for rows in blocks(len(faces)):
        first, second, third = (corner_columns(positions, faces[rows]) - middle) / size
        total += float(np.sum(first * cross(second, third)))
    return total / 6


def degenerate(positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Bool[np.ndarray, "F"]:
    """Which faces have no area, judged by their height beside their longest side."""
    result = np.empty(len(faces), dtype=bool)
    for rows in blocks(len(faces)):
        corners = corner_columns(positions, faces[rows])
        sides = [corners[(j + 1) % 3] - corners[j] for j in range(3)]
        size = np.max([largest(side) for side in sides], axis=0)
        size = np.where(size > 0, size, 1.0)
        sides = [side / size for side in sides]
        longest = np.max([length(side) for side in sides], axis=0)
        twice_area = length(cross(sides[0], sides[1]))
        # The height cannot be known better than the coordinates are.
        rounding = 4 * np.finfo(np.float64).eps * np.max([largest(corner) for corner in corners], axis=0) / size
        result[rows] = twice_area <= np.maximum(FLAT * longest, rounding) * longest
    return result


def _components(welded: Int[np.ndarray, "F 3"]) -> int:
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    places = int(welded.max(initial=-1)) + 1
    first, second, third = welded.T
    # Every place hangs on a lower one of a face of it, and so on one place of its piece. What is left of the graph
    # between those is small, and the walk through all of it was a tenth of the time of reading a mesh.
    lowest = np.minimum(np.minimum(first, second), third)
    root = np.arange(places)
    for corner in (first, second, third):
        root[corner] = lowest
    while not np.array_equal(root, further := root[root]):
        root = further
    named = np.zeros(places, dtype=bool)
    for corner in (first, second, third):
        named[corner] = True
    lowest, first, second, third = root[lowest], root[first], root[second], root[third]
    tail = np.concatenate([each[each != lowest] for each in (first, second, third)])
    head = np.concatenate([lowest[each != lowest] for each in (first, second, third)])
    graph = coo_matrix((np.ones(len(tail), dtype=bool), (tail, head)), (places, places))
    _, label = connected_components(graph, directed=False)
    return len(np.unique(label[root[named]]))
