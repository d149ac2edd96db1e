"""What a glTF file draws: each primitive of each node, decoded, at rest and in the world."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Float64, Int64

from torchprt.errors import InputError

from .gltf_decode import DRACO, Decoded, decode_draco
from .gltf_document import Document, as_declared, normalised
from .gltf_nodes import Matrix, Nodes

POINTS, LINES, LINE_LOOP, LINE_STRIP, TRIANGLES, TRIANGLE_STRIP, TRIANGLE_FAN = range(7)
"""Modes of a primitive, section 3.7.2.1 of the specification of glTF 2.0."""


@dataclass(eq=False)
class Primitive:
    """The arrays of a primitive as the file has them."""

    attributes: dict[str, np.ndarray]
    """`[V, width]` by name; normalised whole numbers are float64."""
    faces: Int64[np.ndarray, "F 3"]
    """Counter-clockwise, strips and fans taken apart."""
    targets: list[dict[str, np.ndarray]]
    """What morph targets add to attributes."""
    material: int | None


@dataclass(eq=False)
class Piece:
    """A primitive as one node draws it: at rest, in the world frame, vertices in the order of the file."""

    node: int | None
    mesh: int
    primitive: int
    instance: int
    """Of EXT_mesh_gpu_instancing; else 0."""
    matrix: Matrix
    """From the primitive to the world; the identity for a skinned mesh, whose joints place it."""
    positions: Float64[np.ndarray, "V 3"]
    faces: Int64[np.ndarray, "F 3"]
    """Counter-clockwise seen from outside, also where the node mirrors."""
    mirrored: bool
    """Whether for that they are turned from how the file has them."""
    normals: Float64[np.ndarray, "V 3"] | None
    """In the direction that they have in the world, not of unit length."""
    tangents: Float64[np.ndarray, "V 3"] | None
    uv: dict[int, Float64[np.ndarray, "V 2"]]
    """Texture coordinates by their number n in TEXCOORD_n; v runs down the picture."""
    colours: Float64[np.ndarray, "V 3"] | Float64[np.ndarray, "V 4"] | None
    """Linear RGB or RGBA."""
    material: int | None
    handed: Float64[np.ndarray, "V"] | None = None
    """1 or -1: the bitangent is that times normal x tangent; None without tangents."""


@dataclass(eq=False)
class Pieces:
    """The pieces of a document in the order of its meshes, then of their primitives, then of its nodes, instances."""

    pieces: list[Piece]
    notes: list[str] = field(default_factory=list)
    """What was left out, in sentences."""


def pieces(document: Document) -> Pieces:
    """All that the default scene of a document draws.

    - Skins and morph targets are at rest: the pose of the nodes as they stand, the default weights. A skinned mesh
      is where its joints are, whatever its own node says.
    - Points and lines are left out, and noted. Cameras, lights and animations are of no concern here.
    - Without any node, every mesh is drawn once where it is.

    Raises InputError, naming the file, where it names something that does not exist, is cut short or is damaged.
    """
    nodes = Nodes(document)
    meshes = document.all("meshes")
    drawn: dict[int, list[int | None]] = {number: [] for number in range(len(meshes))}
    for number in nodes.shown:
        mesh = document.entry("nodes", number).get("mesh")
        if mesh is not None:
            document.entry("meshes", mesh)
            drawn[mesh].append(number)
    if not document.all("nodes"):
        drawn = {number: [None] for number in drawn}
    found: list[Piece] = []
    left: Counter[str] = Counter()
    for mesh, users in drawn.items():
        for place, entry in enumerate(meshes[mesh]["primitives"] if users else ()):
            mode = entry.get("mode", TRIANGLES)
            if mode < TRIANGLES:
                left["points" if mode == POINTS else "lines"] += len(users)
                continue
            primitive = read_primitive(document, entry)
            for node in users:
                matrices = [np.eye(4)] if node is None else nodes.instances(node)
                for instance, matrix in enumerate(matrices):
                    found.append(_placed(nodes, primitive, (node, mesh, place, instance), matrix))
    notes = [
        f"{count} {'primitive' if count == 1 else 'primitives'} of {kind} left out." for kind, count in left.items()
    ]
    return Pieces(found, notes)


def read_primitive(document: Document, entry: dict[str, Any]) -> Primitive:
    """The arrays of a primitive of triangles, decompressed. Raises InputError as `pieces` does."""
    packed = entry.get("extensions", {}).get(DRACO)
    attributes: dict[str, np.ndarray] = {}
    decoded: Decoded | None = None
    if packed is not None:
        decoded = decode_draco(document.view(packed["bufferView"]), document.source)
    for name, number in entry["attributes"].items():
        if decoded is not None and packed is not None and name in packed["attributes"]:
            values = decoded.attributes[packed["attributes"][name]]
            accessor = document.entry("accessors", number)
            attributes[name] = normalised(as_declared(values, accessor), accessor)
        else:
            attributes[name] = document.accessor(number)
    count = len(attributes["POSITION"])
    for name, values in attributes.items():
        if len(values) != count:
            raise InputError(
                f"{document.source} has {len(values)} of {name} for {count} vertices: export the mesh again"
            )
    targets = [
        {name: np.asarray(document.accessor(number), np.float64) for name, number in target.items()}
        for target in entry.get("targets", ())
    ]
    if decoded is not None:
        return Primitive(attributes, decoded.indices.reshape(-1, 3), targets, entry.get("material"))
    flat = np.arange(count)
    if "indices" in entry:
        flat = document.accessor(entry["indices"]).astype(np.int64).reshape(-1)
    return Primitive(attributes, triangles(flat, entry.get("mode", TRIANGLES)), targets, entry.get("material"))


def triangles(indices: Int64[np.ndarray, "I"], mode: int) -> Int64[np.ndarray, "F 3"]:
    """Faces of the vertices that a primitive names one after the other. Corners left over at the end make none."""
    if mode == TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    if len(indices) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == TRIANGLE_FAN:
        return np.stack([indices[1:-1], indices[2:], np.full(len(indices) - 2, indices[0])], axis=1)
    # Every second triangle of a strip is turned.
    odd = np.arange(len(indices) - 2) % 2
    first, second, third = indices[:-2], indices[1:-1], indices[2:]
    return np.stack([first, np.where(odd, third, second), np.where(odd, second, third)], axis=1)


def _placed(nodes: Nodes, primitive: Primitive, where: tuple[int | None, int, int, int], matrix: Matrix) -> Piece:
    document, (node, mesh, _, _) = nodes.document, where
    entry = {} if node is None else document.entry("nodes", node)
    values = _morphed(primitive, entry.get("weights", document.entry("meshes", mesh).get("weights", ())))
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    if "skin" in entry and "JOINTS_0" in values and "WEIGHTS_0" in values:
        blended = _blended(nodes.joints(entry["skin"]), values)
        linear, shift, matrix = blended[:, :3, :3], blended[:, :3, 3], np.eye(4)
    positions = _turned(linear, values["POSITION"]) + shift
    # A transform that mirrors turns the winding; the standard asks to turn it back.
    mirrored = float(np.median(np.linalg.det(linear))) < 0 if len(positions) else False
    normals, tangents = values.get("NORMAL"), values.get("TANGENT")
    if normals is not None:
        # Normals go by the cofactor matrix, which exists even where the inverse does not.
        rows = [linear[..., row, :] for row in range(3)]
        cofactor = np.stack(
            [np.cross(rows[1], rows[2]), np.cross(rows[2], rows[0]), np.cross(rows[0], rows[1])], axis=-2
        )
        normals = _turned(cofactor, normals) * (-1 if mirrored else 1)
    colours = values.get("COLOR_0")
    sets = sorted(int(name[9:]) for name in values if name.startswith("TEXCOORD_") and name[9:].isdigit())
    return Piece(
        *where,
        matrix,
        positions,
        primitive.faces[:, ::-1] if mirrored else primitive.faces,
        mirrored,
        normals,
        None if tangents is None else _turned(linear, tangents[:, :3]),
        {number: values[f"TEXCOORD_{number}"] for number in sets},
        colours,
        primitive.material,
        # The cross product does not mirror with its factors.
        None if tangents is None else np.sign(tangents[:, 3:].sum(axis=1)) * (-1 if mirrored else 1),
    )


def _turned(linear: np.ndarray, values: Float[np.ndarray, "V 3"]) -> Float64[np.ndarray, "V 3"]:
    """Vectors times one matrix `[3, 3]`, or each times its own `[V, 3, 3]`."""
    if linear.ndim == 2:
        result: np.ndarray = values @ linear.T
        return result
    return np.einsum("vij,vj->vi", linear, values)


def _morphed(primitive: Primitive, weights: Any) -> dict[str, Float64[np.ndarray, "V width"]]:
    """Attributes in float64 with the weighted targets added."""
    values = {name: np.array(array, np.float64) for name, array in primitive.attributes.items()}
    for weight, target in zip(weights, primitive.targets, strict=False):
        for name, added in target.items():
            if weight and name in values:
                values[name][:, : added.shape[1]] += weight * added
    return values


def _blended(joints: Float64[np.ndarray, "J 4 4"], values: dict[str, np.ndarray]) -> Float64[np.ndarray, "V 4 4"]:
    """The matrix of each vertex, of all its joints; weights are brought to sum to one, as viewers do."""
    sets = [number for number in range(8) if f"JOINTS_{number}" in values and f"WEIGHTS_{number}" in values]
    which = np.concatenate([values[f"JOINTS_{number}"] for number in sets], axis=1).astype(np.int64)
    weights = np.concatenate([values[f"WEIGHTS_{number}"] for number in sets], axis=1)
    total = weights.sum(axis=1, keepdims=True)
    # A vertex without weights follows the first joint it names.
    weights = np.where(total > 0, weights / np.where(total > 0, total, 1), np.eye(1, weights.shape[1]))
    result = np.zeros((len(which), 4, 4))
    for column in range(which.shape[1]):
        result += weights[:, column, None, None] * joints[which[:, column]]
    return result
