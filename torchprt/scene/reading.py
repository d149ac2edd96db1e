"""Mesh files: what they hold, unchanged, or one sentence that says why not."""

import contextlib
import io
import json
import logging
import os
import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchprt.errors import InputError
from torchprt.suffixes import refuse_other

from .mesh import Mesh, make_mesh
from .obj import parse_obj


class Raw(NamedTuple):
    """A piece of a file before it is checked."""

    positions: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None = None
    colours: np.ndarray | None = None
    """Linear RGB."""
    uv: np.ndarray | None = None
    """Texture coordinates of every corner, [F, 3, 2]; NaN where there are none."""
    tangents: np.ndarray | None = None


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """The mesh in a .ply, .obj, .glb, .gltf, .stl or .off file, with a report of what was found.

    - The order of vertices is the file's own; nothing is dropped or merged. Polygons become triangles.
      An .obj vertex that faces use with several normals is repeated beside itself, once for each of them.
    - The pieces of a .glb or .gltf follow each other in the order of its meshes and then of its nodes,
      each in place in the world.
    - Colours: whole numbers in a .ply are sRGB and become linear; floating point (.ply, .obj) is taken as
      linear; .glb is linear by its standard. Textures and materials are not read.
    - Texture coordinates (`vt` of an .obj, `s t`, `u v`, `texture_u texture_v` or `s1 t1` of the vertices of a .ply,
      TEXCOORD_0 of a .glb) give the tangents, unless the file holds tangents (TANGENT of a .glb).
    - An .obj does not say how much it holds: one that was cut at the end of a line cannot be told from a whole one.

    Raises InputError, naming the file, if it is missing, empty, cut short, not of its kind, compressed, without
    faces, or faulty as `make_mesh` says.
    """
    source = Path(path)
    reader = READERS.get(source.suffix.lower())
    if reader is None:
        refuse_other(source, "a mesh")
        known = ", ".join(READERS)
        raise InputError(f"{source} is not a mesh file that can be read: convert it to one of {known}")
    try:
        data = source.read_bytes()
    except FileNotFoundError as fault:
        raise InputError(f"{source} does not exist: check the name") from fault
    except OSError as fault:
        raise InputError(f"{source} cannot be read ({fault.strerror}): check the name and its permissions") from fault
    if not data.strip():
        raise InputError(f"{source} is empty: export the mesh again")
    try:
        with _strictly():
            pieces = reader(data, source)
        raw = _join(pieces)
    except InputError:
        raise
    except Exception as fault:  # A parser meets damaged bytes with exceptions of any kind.
        raise InputError(
            f"{source} is damaged, cut short or not a {source.suffix.lower()} file of triangles "
            f"({_reason(fault)}): export the mesh again"
        ) from fault
    return make_mesh(raw.positions, raw.faces, raw.normals, raw.colours, source, raw.uv, raw.tangents)


@contextlib.contextmanager
def _strictly() -> Iterator[None]:
    """Doubts become faults: numpy reads text that is not numbers as far as it can and only warns, trimesh only logs."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)
            yield
    finally:
        logger.setLevel(level)


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Linear values of sRGB ones in [0, 1]. Source: IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _reason(fault: Exception) -> str:
    return (str(fault).strip().splitlines() or [type(fault).__name__])[0][:100].rstrip(".")


def _triangles(faces: Any) -> np.ndarray:
    from trimesh.geometry import triangulate_quads

    return np.asarray(triangulate_quads(faces), dtype=np.int64).reshape(-1, 3)


def _join(pieces: list[Raw]) -> Raw:
    """All pieces as one; what only some pieces have is marked as missing in the others, colours are left out."""
    if not pieces:
        return Raw(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    if len(pieces) == 1:
        return pieces[0]
    starts = np.cumsum([0] + [len(piece.positions) for piece in pieces])
    normals = None
    if any(piece.normals is not None for piece in pieces):
        normals = np.concatenate([np.zeros_like(p.positions) if p.normals is None else p.normals for p in pieces])
    colours = None
    if all(piece.colours is not None for piece in pieces):
        colours = np.concatenate([p.colours for p in pieces if p.colours is not None])
    uv = None
    if any(piece.uv is not None for piece in pieces):
        uv = np.concatenate([np.full((len(p.faces), 3, 2), np.nan) if p.uv is None else p.uv for p in pieces])
    tangents = None
    if any(piece.tangents is not None for piece in pieces):
        tangents = np.concatenate([np.zeros_like(p.positions) if p.tangents is None else p.tangents for p in pieces])
    return Raw(
        np.concatenate([piece.positions for piece in pieces]),
        # An index that is wrong in its own piece must not become right in the next.
        np.concatenate(
            [
                np.where((p.faces < 0) | (p.faces >= len(p.positions)), -1, p.faces + start)
                for p, start in zip(pieces, starts[:-1], strict=True)
            ]
        ),
        normals,
        colours,
        uv,
        tangents,
    )


def _read_ply(data: bytes, source: Path) -> list[Raw]:
    from trimesh.exchange.ply import load_ply

    loaded = load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True)
    elements = loaded["metadata"]["_ply_raw"]
    _refuse_short_ply(data, source)
    if "vertices" not in loaded:
        return []
    positions = np.asarray(loaded["vertices"], dtype=np.float64)
    declared = elements["vertex"]["length"]
    if len(positions) != declared:
        raise InputError(f"{source} is cut short, {len(positions)} of {declared} vertices: export the mesh again")
    faces = _triangles(loaded["faces"]) if loaded.get("faces") is not None else np.zeros((0, 3), np.int64)
    declared = elements["face"]["length"] if "face" in elements else 0
    if len(faces) < declared:
        raise InputError(
            f"{source} is cut short or has faces of fewer than three corners, {len(faces)} of {declared} faces: "
            "export the mesh again"
        )
    vertex = elements["vertex"]
    return [Raw(positions, faces, loaded.get("vertex_normals"), _ply_colours(vertex), _ply_uv(vertex, faces))]


def _refuse_short_ply(data: bytes, source: Path) -> None:
    """The last line of a text file can lose corners of its face without any count noticing."""
    header, _, body = data.partition(b"end_header")
    last = body.split(b"\n")[-1] or (body.split(b"\n")[-2] if b"\n" in body else b"")
    tail = header.rsplit(b"element", 1)[-1].split(b"property", 2)
    if b"format ascii" not in header or len(tail) < 2 or tail[1].split()[:1] != [b"list"]:
        return
    numbers = last.split()
    if numbers and len(numbers) <= int(numbers[0]):
        raise InputError(f"{source} is cut short in its last line: export the mesh again")


def _ply_colours(vertex: dict[str, Any]) -> np.ndarray | None:
    names = ["red", "green", "blue"]
    if not all(name in vertex["properties"] for name in names):
        return None
    channels = [np.asarray(vertex["data"][name]).reshape(-1) for name in names]
    # Text is parsed to numbers of any type: the header says which type was meant.
    kinds = [np.dtype(vertex["properties"][name]) for name in names]
    if all(np.issubdtype(kind, np.unsignedinteger) for kind in kinds):
        largest = np.array([np.iinfo(kind).max for kind in kinds], dtype=np.float64)
        return srgb_to_linear(np.stack(channels, axis=1) / largest)
    return np.stack(channels, axis=1).astype(np.float64)


def _ply_uv(vertex: dict[str, Any], faces: np.ndarray) -> np.ndarray | None:
    """Texture coordinates of the corners of `faces`, under any of the names that exporters use."""
    for names in (("s", "t"), ("u", "v"), ("texture_u", "texture_v"), ("s1", "t1")):
        if all(name in vertex["properties"] for name in names):
            uv = np.stack([np.asarray(vertex["data"][name], np.float64).reshape(-1) for name in names], axis=1)
            # A face that names no vertex is refused later, in words.
            return uv[faces] if not faces.size or 0 <= faces.min() <= faces.max() < len(uv) else None
    return None


def _read_obj(data: bytes, source: Path) -> list[Raw]:
    return [Raw(*parse_obj(data, source))]


def _read_stl(data: bytes, source: Path) -> list[Raw]:
    from trimesh.exchange.stl import load_stl

    loaded = load_stl(io.BytesIO(data))
    text = data.strip().lower()
    # Binary files may begin with "solid" too; their length is then checked against their count.
    faces = int.from_bytes(data[80:84], "little") if len(data) >= 84 else 0
    binary = len(data) == 84 + 50 * faces
    if not binary and not text.rsplit(b"\n", 1)[-1].strip().startswith(b"endsolid"):
        raise InputError(f"{source} is cut short or not an .stl file: export the mesh again")
    solids = list(loaded["geometry"].values()) if "geometry" in loaded else [loaded] if "faces" in loaded else []
    pieces = [Raw(np.asarray(s["vertices"], np.float64), np.asarray(s["faces"], np.int64)) for s in solids]
    if not binary and sum(len(piece.faces) for piece in pieces) != text.count(b"endfacet"):
        raise InputError(f"{source} has facets without three corners: export the mesh again")
    return pieces


def _read_off(data: bytes, source: Path) -> list[Raw]:
    from trimesh.exchange.off import load_off
    from trimesh.util import comment_strip, decode_text

    text = comment_strip(decode_text(data)).strip()
    loaded = load_off(io.BytesIO(data))
    lines = [line.split() for line in text.split("OFF", 1)[1].splitlines() if line.strip()]
    vertices, faces = int(lines[0][0]), int(lines[0][1])
    rows = lines[1 + vertices : 1 + vertices + faces]
    if len(rows) < faces or any(len(row) <= int(row[0]) for row in rows):
        raise InputError(f"{source} is cut short: export the mesh again")
    if any(int(row[0]) < 3 for row in rows):
        raise InputError(f"{source} has faces of fewer than three corners: export the mesh again")
    return [Raw(np.asarray(loaded["vertices"], np.float64), _triangles(loaded["faces"]))]


def _read_gltf(data: bytes, source: Path) -> list[Raw]:
    from trimesh import Scene
    from trimesh.exchange.gltf import load_glb, load_gltf
    from trimesh.resolvers import FilePathResolver

    binary = source.suffix.lower() == ".glb"
    if binary and len(data) < int.from_bytes(data[8:12], "little"):
        raise InputError(f"{source} is cut short, {len(data)} bytes: export the mesh again")
    header = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")] if binary else data)
    used = {*header.get("extensionsUsed", ()), *header.get("extensionsRequired", ())}
    compressed = {"EXT_meshopt_compression", "KHR_meshopt_compression"} & used
    if not find_spec("DracoPy"):
        compressed |= {"KHR_draco_mesh_compression"} & used
    if compressed:
        raise InputError(f"{source} is compressed with {min(compressed)}: export the mesh without compression")
    loaded = (load_glb if binary else load_gltf)(
        io.BytesIO(_with_own_names(data, header, binary)), resolver=FilePathResolver(str(source)), skip_materials=True
    )
    geometry = loaded["geometry"]
    scene = Scene(base_frame=loaded["base_frame"])
    for node in loaded["graph"]:
        scene.graph.update(**node)
    # trimesh walks the nodes from the last to the first: of one mesh, the node met last is the file's first.
    met = [node for node in loaded["graph"] if "geometry" in node][::-1]
    rank = {name: number for number, name in enumerate(geometry)}
    pieces = []
    for node in sorted(met, key=lambda node: rank[node["geometry"]]):
        piece = geometry[node["geometry"]]
        if piece.get("faces") is None:
            continue
        matrix, _ = scene.graph[node["frame_to"]]
        pieces.append(_placed(piece, matrix))
    return pieces


def _with_own_names(data: bytes, header: dict[str, Any], binary: bool) -> bytes:
    """The file with its texture coordinates and tangents named so that trimesh hands them on without materials."""
    for mesh in header.get("meshes", ()):
        for primitive in mesh["primitives"]:
            attributes = primitive["attributes"]
            attributes.update(
                {f"_{name}": attributes[name] for name in ("TEXCOORD_0", "TANGENT") if name in attributes}
            )
    text = json.dumps(header).encode()
    if not binary:
        return text
    text += b" " * (-len(text) % 4)
    rest = data[20 + int.from_bytes(data[12:16], "little") :]
    total = 20 + len(text) + len(rest)
    return data[:8] + total.to_bytes(4, "little") + len(text).to_bytes(4, "little") + data[16:20] + text + rest


def _placed(piece: dict[str, Any], matrix: np.ndarray) -> Raw:
    linear = matrix[:3, :3]
    positions = np.asarray(piece["vertices"], np.float64) @ linear.T + matrix[:3, 3]
    faces = np.asarray(piece["faces"], np.int64)
    # A transform that mirrors turns the winding; the standard asks to turn it back.
    mirrored = np.linalg.det(linear) < 0
    normals = piece.get("vertex_normals")
    if normals is not None:
        # Normals go by the cofactor matrix, which exists even where the inverse does not.
        cofactor = np.stack(
            [np.cross(linear[1], linear[2]), np.cross(linear[2], linear[0]), np.cross(linear[0], linear[1])]
        )
        normals = np.asarray(normals, np.float64) @ cofactor.T * (-1 if mirrored else 1)
    colours = piece.get("vertex_colors")
    if colours is not None:
        largest = np.iinfo(colours.dtype).max if np.issubdtype(colours.dtype, np.integer) else 1
        colours = np.asarray(colours, np.float64)[:, :3] / largest
    faces = faces[:, ::-1] if mirrored else faces
    named = piece.get("vertex_attributes", {})
    uv = named.get("_TEXCOORD_0")
    if uv is not None:
        inside = not faces.size or 0 <= faces.min() <= faces.max() < len(uv)
        uv = np.asarray(uv, np.float64)[faces] if inside else None
    tangents = named.get("_TANGENT")
    if tangents is not None:
        tangents = np.asarray(tangents, np.float64)[:, :3] @ linear.T
    return Raw(positions, faces, normals, colours, uv, tangents)


READERS: dict[str, Callable[[bytes, Path], list[Raw]]] = {
    ".ply": _read_ply,
    ".obj": _read_obj,
    ".glb": _read_gltf,
    ".gltf": _read_gltf,
    ".stl": _read_stl,
    ".off": _read_off,
}
