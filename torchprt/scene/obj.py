"""Wavefront .obj, in the order of the file.

trimesh groups faces by material, drops or reorders vertices on the way, reads relative indices as if they
stood at the end of the file, and takes index 0 for 1. Transfer is stored by vertex, so the order must be kept.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from torchprt.errors import InputError
from torchprt.scene import obj_runs

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
    lines = text.splitlines()
    said = _Said(source)
    number = 0
    for keyword, some in itertools.groupby(lines, lambda line: line[:2]):
        run = list(some)
        # Most files are a few long runs of lines of one shape.
        if not (len(run) >= obj_runs.LEAST and said.all_at_once(keyword, run)):
            for place, line in enumerate(run, start=number + 1):
                try:
                    said.line(line)
                except ValueError as fault:
                    raise InputError(f"{source} line {place} {fault}: export the mesh again") from fault
        number += len(run)
    return said.parsed()


class _Rows:
    """Rows of numbers that come one by one or many at once."""

    def __init__(self, width: int, dtype: type = np.float64):
        self._width, self._dtype = width, dtype
        self._blocks: list[np.ndarray] = []
        self._single: list[Sequence[float | int]] = []
        self._before = 0

    def __len__(self) -> int:
        return self._before + len(self._single)

    def append(self, row: Sequence[float | int]) -> None:
        self._single.append(row)

    def extend(self, block: np.ndarray) -> None:
        self._flush()
        self._blocks.append(block)
        self._before += len(block)

    def array(self) -> np.ndarray:
        self._flush()
        return np.concatenate([np.zeros((0, self._width), self._dtype), *self._blocks])

    def _flush(self) -> None:
        if self._single:
            block: np.ndarray = np.array(self._single, dtype=self._dtype).reshape(-1, self._width)
            self._single = []
            self._blocks.append(block)
            self._before += len(block)


class _Said:
    """What the lines have said so far."""

    def __init__(self, source: Path):
        self._source = source
        self._vertices, self._normals, self._textures = _Rows(3), _Rows(3), _Rows(2)
        self._colours, self._coloured = _Rows(3), True
        self._corners, self._used = _Rows(3, np.int64), _Rows(1, np.int64)
        self._names: dict[str, int] = {}
        self._libraries: list[str] = []
        self._material = -1

    def line(self, line: str) -> None:
        """Raises ValueError if it does not say what it must."""
        words = line.split("#", 1)[0].split()
        if not words:
            return
        if words[0] == "v":
            numbers = _numbers(words[1:], least=3)
            self._vertices.append(numbers[:3])
            # Four numbers are a weight; six or more are a position and a colour.
            self._coloured = self._coloured and len(numbers) >= 6
            if self._coloured:
                self._colours.append(numbers[3:6])
        elif words[0] == "vn":
            self._normals.append(_numbers(words[1:4], least=3))
        elif words[0] == "vt":
            # A map of one dimension has u alone.
            self._textures.append([*_numbers(words[1:3], least=1), 0.0][:2])
        elif words[0] == "f":
            known = len(self._vertices), len(self._normals), len(self._textures)
            polygon = [_corner(word, *known) for word in words[1:]]
            if len(polygon) < 3:
                raise ValueError("has a face of fewer than three corners")
            for second, third in itertools.pairwise(polygon[1:]):
                for corner in (polygon[0], second, third):
                    self._corners.append(corner)
                self._used.append((self._material,))
        elif words[0] == "usemtl":
            names = self._names
            self._material = names.setdefault(" ".join(words[1:]), len(names)) if words[1:] else -1
        elif words[0] == "mtllib":
            # Several names, or one with spaces: the file system knows.
            whole = " ".join(words[1:])
            self._libraries += [whole] if (self._source.parent / whole).is_file() else words[1:]

    def all_at_once(self, keyword: str, lines: list[str]) -> bool:
        """Whether lines that begin with the same two letters were all of one shape, and have been read."""
        if keyword in ("f ", "f\t"):
            corners = obj_runs.corners(lines)
            if corners is None or corners.shape[1] < 3:
                return False
            self._faces(corners - 1)
            return True
        if keyword not in ("v ", "v\t", "vn", "vt") or lines[0].split(None, 1)[0] != keyword.strip():
            return False
        found = obj_runs.numbers(lines)
        if found is None or found.shape[1] < (1 if keyword == "vt" else 3):
            return False
        if keyword == "vn":
            self._normals.extend(found[:, :3])
        elif keyword == "vt":
            self._textures.extend(np.concatenate([found, np.zeros((len(found), 1))], 1)[:, :2])
        else:
            self._vertices.extend(found[:, :3])
            self._coloured = self._coloured and found.shape[1] >= 6
            if self._coloured:
                self._colours.extend(found[:, 3:6])
        return True

    def _faces(self, corners: np.ndarray) -> None:
        """Adds polygons `[L, k, 3]` as fans."""
        count, sides, _ = corners.shape
        if sides > 3:
            corners = corners[:, [(0, each, each + 1) for each in range(1, sides - 1)]]
        self._corners.extend(corners.reshape(-1, 3))
        self._used.extend(np.full((count * (sides - 2), 1), self._material, np.int64))

    def parsed(self) -> Parsed:
        """All of it. Raises InputError if a face names what is not there."""
        positions, normals, textures = (each.array() for each in (self._vertices, self._normals, self._textures))
        indices = self._corners.array()
        pairs, texture = indices[:, :2], indices[:, 2]
        for what, named, there in (
            ("vertex", pairs[:, 0], positions),
            ("normal", pairs[:, 1], normals),
            ("texture coordinates", texture, textures),
        ):
            if len(named) and named.max() >= len(there):
                raise InputError(
                    f"{self._source} has a face that names {what} {named.max() + 1} of {len(there)}: "
                    "export the mesh again"
                )
        vertex, normal, faces = _split(pairs, len(positions), len(normals))
        directions = None
        if len(normals) and (normal >= 0).any():
            directions = np.where(normal[:, None] >= 0, normals[normal], 0.0)
        colours = self._colours.array()[vertex] if len(positions) and self._coloured else None
        uv = None
        if len(textures) and (texture >= 0).any():
            uv = np.where(texture[:, None] >= 0, textures[texture], np.nan).reshape(-1, 3, 2)
        materials = self._used.array()[:, 0] if self._names else None
        return Parsed(
            positions[vertex], faces, directions, colours, uv, materials, tuple(self._names), tuple(self._libraries)
        )


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


def _split(pairs: np.ndarray, vertices: int, normals: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertex and normal of every vertex of the result, in the order of the file, and the faces among them."""
    vertex, normal = pairs[:, 0], pairs[:, 1]
    only = np.full(vertices, -1)
    only[vertex] = normal
    if (only[vertex] == normal).all():
        return np.arange(vertices), only, vertex.reshape(-1, 3).copy()
    unused = np.setdiff1d(np.arange(vertices), vertex)
    # A pair as one number, in the order of pairs.
    every = np.concatenate([vertex, unused]) * (normals + 1) + np.concatenate([normal + 1, np.zeros_like(unused)])
    unique, inverse = np.unique(every, return_inverse=True)
    faces = inverse.reshape(-1)[: len(pairs)].reshape(-1, 3)
    return unique // (normals + 1), unique % (normals + 1) - 1, faces.astype(np.int64)
