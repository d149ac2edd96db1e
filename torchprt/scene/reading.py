"""Mesh files: what they hold, unchanged, or one sentence that says why not."""

import contextlib
import io
import logging
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from torchprt.errors import InputError
from torchprt.suffixes import check_readable, refuse_other

from .gltf import Document, Piece
from .gltf import pieces as gltf_pieces
from .gltf_material import gltf_paints
from .mesh import Mesh, make_mesh
from .mtl import mtl_paints, picture_map
from .obj import parse_obj
from .paint import NONE, Paint
from .texture import srgb_to_linear
from .usd import read_usd


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
    materials: np.ndarray | None = None
    """Which material of the file every face has, [F] whole numbers from 0; -1 for none."""
    more_uv: Mapping[int, np.ndarray] = MappingProxyType({})
    """Further sets of texture coordinates by their number from 1 on, each as `uv`, which is set 0."""
    notes: tuple[str, ...] = ()
    """What the file holds that is not here, in sentences."""
    paints: Callable[[], tuple[Paint, ...]] | None = None
    """The materials of the whole file, read when they are asked for; the last is that of faces without any."""
    tint: np.ndarray | None = None
    """What the materials are multiplied by at every vertex, linear [V, 3]; None for 1."""
    handed: np.ndarray | None = None
    """Of each vertex with a tangent of the file 1 or -1, which normal x tangent is multiplied by; 0 without."""


def read_mesh(path: str | os.PathLike[str]) -> Mesh:
    """The mesh in a .ply, .obj, .glb, .gltf, .stl, .off or .usd file, with a report of what was found.

    - The order of vertices is the file's own; nothing is dropped or merged. Polygons become triangles.
      An .obj vertex that faces use with several normals is repeated beside itself, once for each of them.
    - The pieces of a .glb or .gltf follow each other in the order of its meshes and then of its nodes,
      each in place in the world.
    - Colours: whole numbers in a .ply are sRGB and become linear; floating point (.ply, .obj) is taken as
      linear; .glb is linear by its standard. Textures and materials are read by `read_surface`.
    - Texture coordinates (`vt` of an .obj, `s t`, `u v`, `texture_u texture_v` or `s1 t1` of the vertices of a .ply,
      TEXCOORD_0 of a .glb) give the tangents, unless the file holds tangents (TANGENT of a .glb).
    - An .obj does not say how much it holds: one that was cut at the end of a line cannot be told from a whole one.

    - Of a .glb or .gltf, what its default scene draws: skins and morph targets at rest, instances, Draco and meshopt
      decompressed. Points and lines are left out, and the report says so.
    - Of a .usd, .usda, .usdc or .usdz what `read_usd` says, if torchprt[usd] is installed.

    Raises InputError, naming the file, if it is missing, empty, cut short, not of its kind, without faces, requires
    an extension that is not known, or is faulty as `make_mesh` says.
    """
    return read_raw(path)[0]


def read_raw(path: str | os.PathLike[str]) -> tuple[Mesh, Raw]:
    """The mesh of a file as `read_mesh` has it, and all that was read beside it."""
    source = Path(path)
    reader = READERS.get(source.suffix.lower())
    if reader is None:
        refuse_other(source, "a mesh")
        known = ", ".join(READERS)
        raise InputError(f"{source} is not a mesh file that can be read: convert it to one of {known}")
    check_readable(source)
    try:
        data = source.read_bytes()
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
    mesh = make_mesh(
        raw.positions,
        raw.faces,
        raw.normals,
        raw.colours,
        source,
        raw.uv,
        raw.tangents,
        raw.more_uv,
        v_up=source.suffix.lower() not in (".glb", ".gltf"),
    )
    return replace(mesh, report=replace(mesh.report, notes=raw.notes)), raw


def read_paints(raw: Raw, source: str | os.PathLike[str]) -> tuple[Paint, ...]:
    """The materials of what was read from `source`. Raises InputError, naming it, if they are damaged."""
    try:
        return raw.paints() if raw.paints is not None else ()
    except InputError:
        raise
    except Exception as fault:  # What they hold may be of any type.
        raise InputError(f"{source} has damaged materials ({_reason(fault)}): export the mesh again") from fault


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
        None if all(piece.materials is None for piece in pieces) else _materials(pieces),
        {number: _more_uv(pieces, number) for number in sorted({each for piece in pieces for each in piece.more_uv})},
        tuple(note for piece in pieces for note in piece.notes),
        pieces[0].paints,
        None if all(piece.tint is None for piece in pieces) else _tint(pieces),
        None if all(piece.handed is None for piece in pieces) else _handed(pieces),
    )


def _materials(pieces: list[Raw]) -> np.ndarray:
    none = [np.full(len(piece.faces), -1) if piece.materials is None else piece.materials for piece in pieces]
    return np.concatenate(none)


def _tint(pieces: list[Raw]) -> np.ndarray:
    return np.concatenate([np.ones_like(p.positions) if p.tint is None else p.tint for p in pieces])


def _handed(pieces: list[Raw]) -> np.ndarray:
    return np.concatenate([np.zeros(len(p.positions)) if p.handed is None else p.handed for p in pieces])


def _more_uv(pieces: list[Raw], number: int) -> np.ndarray:
    return np.concatenate([p.more_uv.get(number, np.full((len(p.faces), 3, 2), np.nan)) for p in pieces])


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
    uv = _ply_uv(vertex, faces)
    if uv is None and "face" in elements:
        uv = _ply_wedges(elements["face"], len(faces))
    raw = Raw(positions, faces, loaded.get("vertex_normals"), _ply_colours(vertex), uv)
    return [_ply_materials(raw, data, source)]


def _ply_materials(raw: Raw, data: bytes, source: Path) -> Raw:
    """With the picture that a comment names, as scanners write it, or with the colours of the vertices."""
    head = data.partition(b"end_header")[0].decode("utf-8", errors="replace").splitlines()
    named = [line.split(None, 2)[2].strip() for line in head if line.lower().startswith("comment texturefile ")]
    if not named:
        return raw._replace(tint=raw.colours)
    left = ["further pictures"] if len(named) > 1 else []
    # Scanners write the same colours twice, in a picture and coarser at the vertices.
    left += ["vertex colours"] if raw.colours is not None else []
    picture = picture_map(source.parent / named[0])
    paint = Paint(named[0], colour_map=picture, reflectance=(0.0, 0.0, 0.0), left=tuple(left))
    return raw._replace(materials=np.zeros(len(raw.faces), np.int64), paints=lambda: (paint, NONE))


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


def _ply_wedges(face: dict[str, Any], faces: int) -> np.ndarray | None:
    """Texture coordinates that scanners write with the faces, if all are triangles."""
    if "texcoord" not in face["properties"]:
        return None
    pairs = face["data"]["texcoord"]
    # Binary lists come with their length, text without.
    pairs = np.asarray(pairs["f1"] if getattr(pairs, "dtype", None) is not None and pairs.dtype.names else pairs)
    return pairs.astype(np.float64).reshape(-1, 3, 2) if pairs.shape == (faces, 6) else None


def _read_obj(data: bytes, source: Path) -> list[Raw]:
    parsed = parse_obj(data, source)

    def paints() -> tuple[Paint, ...]:
        return (*mtl_paints(source, parsed.libraries, parsed.names), NONE)

    raw = Raw(*parsed[:5], materials=parsed.materials, tint=parsed.colours)
    return [raw if parsed.materials is None else raw._replace(paints=paints)]


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
    document = Document(data, source)
    found = gltf_pieces(document)
    result = [_raw(piece)._replace(paints=lambda: gltf_paints(document)) for piece in found.pieces]
    if result:
        result[0] = result[0]._replace(notes=tuple(found.notes))
    elif found.notes:
        raise InputError(f"{source} holds no triangles ({' '.join(found.notes)}): give a mesh of triangles")
    return result


def _raw(piece: Piece) -> Raw:
    faces = piece.faces
    inside = not faces.size or 0 <= faces.min() <= faces.max() < len(piece.positions)
    # A face that names no vertex is refused later, in words.
    corners = {number: values[faces] for number, values in piece.uv.items()} if inside else {}
    return Raw(
        piece.positions,
        faces,
        piece.normals,
        None if piece.colours is None else piece.colours[:, :3],
        corners.pop(0, None),
        piece.tangents,
        np.full(len(faces), -1 if piece.material is None else piece.material),
        corners,
        tint=None if piece.colours is None else piece.colours[:, :3],
        handed=piece.handed,
    )


def _read_usd(data: bytes, source: Path) -> list[Raw]:
    meshes, notes = read_usd(source)
    result = [Raw(*mesh, tint=mesh.colours) for mesh in meshes]
    return [result[0]._replace(notes=tuple(notes)), *result[1:]] if result else []


READERS: dict[str, Callable[[bytes, Path], list[Raw]]] = {
    ".ply": _read_ply,
    ".obj": _read_obj,
    ".glb": _read_gltf,
    ".gltf": _read_gltf,
    ".stl": _read_stl,
    ".off": _read_off,
    ".usd": _read_usd,
    ".usda": _read_usd,
    ".usdc": _read_usd,
    ".usdz": _read_usd,
}
