"""Wavefront .obj, in the order of the file.

trimesh groups faces by material, drops or reorders vertices on the way, reads relative indices as if they
stood at the end of the file, and takes index 0 for 1. Transfer is stored by vertex, so the order must be kept.
"""

import itertools
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchprt.errors import InputError

Corner = tuple[int, int, int]
"""Vertex, normal and texture coordinates, from 0; -1 for none."""


class Parsed(NamedTuple):
    """What an .obj file holds; None for what it does not."""

    positions: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None
    colours: np.ndarray | None
    """Linear RGB."""
    uv: np.ndarray | None
    """[F, 3, 2], a pair for every corner; NaN where a corner has none."""
    materials: np.ndarray | None
    """[F], which of the names every face has; -1 for none."""
    names: tuple[str, ...]
    """Of the materials that faces use, in the order of their first use."""
    libraries: tuple[str, ...]
    """The files that hold them."""


def parse_obj(data: bytes, source: Path) -> Parsed:
    """Positions, triangles, normals, colours, texture coordinates and the use of materials of an .obj file.

    A vertex that faces use with one normal, or none, stays one vertex; with several it is repeated beside itself.
    Texture coordinates repeat no vertex.
    Raises InputError, naming the line, where the file does not say what it must.
    """
    text = data.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    vertices: list[list[float]] = []
    normals: list[list[float]] = []
    textures: list[list[float]] = []
    corners: list[Corner] = []
    names: dict[str, int] = {}
    libraries: list[str] = []
    material, used = -1, []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices.append(_numbers(words[1:], least=3))
            elif words[0] == "vn":
                normals.append(_numbers(words[1:4], least=3))
            elif words[0] == "vt":
                # A map of one dimension has u alone.
                textures.append([*_numbers(words[1:3], least=1), 0.0][:2])
            elif words[0] == "f":
                polygon = [_corner(word, len(vertices), len(normals), len(textures)) for word in words[1:]]
                if len(polygon) < 3:
                    raise ValueError("has a face of fewer than three corners")
                for second, third in itertools.pairwise(polygon[1:]):
                    corners += (polygon[0], second, third)
                    used.append(material)
            elif words[0] == "usemtl":
                material = names.setdefault(" ".join(words[1:]), len(names)) if words[1:] else -1
            elif words[0] == "mtllib":
                # Several names, or one with spaces: the file system knows.
                whole = " ".join(words[1:])
                libraries += [whole] if (source.parent / whole).is_file() else words[1:]
        except ValueError as fault:
            raise InputError(f"{source} line {number} {fault}: export the mesh again") from fault
    positions = np.array([vertex[:3] for vertex in vertices], dtype=np.float64).reshape(-1, 3)
    indices = np.array(corners, dtype=np.int64).reshape(-1, 3)
    pairs, texture = indices[:, :2], indices[:, 2]
    if len(pairs) and pairs[:, 0].max() >= len(positions):
        raise InputError(
            f"{source} has a face that names vertex {pairs[:, 0].max() + 1} of {len(positions)}: export the mesh again"
        )
    if len(pairs) and pairs[:, 1].max() >= len(normals):
        raise InputError(
            f"{source} has a face that names normal {pairs[:, 1].max() + 1} of {len(normals)}: export the mesh again"
        )
    if len(texture) and texture.max() >= len(textures):
        raise InputError(
            f"{source} has a face that names texture coordinates {texture.max() + 1} of {len(textures)}: "
            "export the mesh again"
        )
    vertex, normal, faces = _split(pairs, len(positions))
    directions = None
    if normals and (normal >= 0).any():
        directions = np.where(normal[:, None] >= 0, np.array(normals)[normal], 0.0)
    colours = None
    # Four numbers are a weight; six or more are a position and a colour.
    if vertices and all(len(values) >= 6 for values in vertices):
        colours = np.array([values[3:6] for values in vertices])[vertex]
    uv = None
    if textures and (texture >= 0).any():
        uv = np.where(texture[:, None] >= 0, np.array(textures)[texture], np.nan).reshape(-1, 3, 2)
    materials = np.array(used, dtype=np.int64) if names else None
    return Parsed(positions[vertex], faces, directions, colours, uv, materials, tuple(names), tuple(libraries))


def _numbers(words: list[str], least: int) -> list[float]:
    if len(words) < least:
        raise ValueError(f"has {len(words)} numbers where {least} are needed")
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ValueError("holds something that is not a number") from None


def _corner(word: str, vertices: int, normals: int, textures: int) -> Corner:
    vertex, texture, normal = [*word.split("/"), "", ""][:3]
    return (
        _index(vertex, vertices),
        _index(normal, normals) if normal else -1,
        _index(texture, textures) if texture else -1,
    )


def _index(word: str, known: int) -> int:
    try:
        index = int(word)
    except ValueError:
        raise ValueError(f"has {word[:20]!r} where an index is needed") from None
    if index == 0 or index < -known:
        raise ValueError(f"has index {index}, which names nothing")
    return index - 1 if index > 0 else known + index


def _split(pairs: np.ndarray, vertices: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex and normal of every vertex of the result, in the order of the file, and the faces among them."""
    unused = np.setdiff1d(np.arange(vertices), pairs[:, 0])
    every = np.concatenate([pairs, np.stack([unused, np.full_like(unused, -1)], axis=1)])
    unique, inverse = np.unique(every, axis=0, return_inverse=True)
    faces = inverse.reshape(-1)[: len(pairs)].reshape(-1, 3)
    return unique[:, 0], unique[:, 1], faces.astype(np.int64)
