"""Wavefront .obj, in the order of the file.

trimesh groups faces by material, drops or reorders vertices on the way, reads relative indices as if they
stood at the end of the file, and takes index 0 for 1. Transfer is stored by vertex, so the order must be kept.
"""

import itertools
from pathlib import Path

import numpy as np

from torchprt.errors import InputError

Corner = tuple[int, int]
"""Vertex and normal, from 0; normal -1 for none."""


def parse_obj(data: bytes, source: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Positions, triangles, normals and linear colours (None where the file has none) of an .obj file.

    A vertex that faces use with one normal, or none, stays one vertex; with several it is repeated beside itself.
    Raises InputError, naming the line, where the file does not say what it must.
    """
    text = data.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    vertices: list[list[float]] = []
    normals: list[list[float]] = []
    corners: list[Corner] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        try:
            if words[0] == "v":
                vertices.append(_numbers(words[1:], least=3))
            elif words[0] == "vn":
                normals.append(_numbers(words[1:4], least=3))
            elif words[0] == "f":
                polygon = [_corner(word, len(vertices), len(normals)) for word in words[1:]]
                if len(polygon) < 3:
                    raise ValueError("has a face of fewer than three corners")
                for second, third in itertools.pairwise(polygon[1:]):
                    corners += (polygon[0], second, third)
        except ValueError as fault:
            raise InputError(f"{source} line {number} {fault}: export the mesh again") from fault
    positions = np.array([vertex[:3] for vertex in vertices], dtype=np.float64).reshape(-1, 3)
    pairs = np.array(corners, dtype=np.int64).reshape(-1, 2)
    if len(pairs) and pairs[:, 0].max() >= len(positions):
        raise InputError(
            f"{source} has a face that names vertex {pairs[:, 0].max() + 1} of {len(positions)}: export the mesh again"
        )
    if len(pairs) and pairs[:, 1].max() >= len(normals):
        raise InputError(
            f"{source} has a face that names normal {pairs[:, 1].max() + 1} of {len(normals)}: export the mesh again"
        )
    vertex, normal, faces = _split(pairs, len(positions))
    directions = None
    if normals and (normal >= 0).any():
        directions = np.where(normal[:, None] >= 0, np.array(normals)[normal], 0.0)
    colours = None
    # Four numbers are a weight; six or more are a position and a colour.
    if vertices and all(len(values) >= 6 for values in vertices):
        colours = np.array([values[3:6] for values in vertices])[vertex]
    return positions[vertex], faces, directions, colours


def _numbers(words: list[str], least: int) -> list[float]:
    if len(words) < least:
        raise ValueError(f"has {len(words)} numbers where {least} are needed")
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ValueError("holds something that is not a number") from None


def _corner(word: str, vertices: int, normals: int) -> Corner:
    parts = word.split("/")
    return _index(parts[0], vertices), _index(parts[2], normals) if len(parts) > 2 and parts[2] else -1


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
