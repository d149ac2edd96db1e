"""A mesh as everything above this room sees it: torch tensors, checked."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Int, Int64, Shaped
from torch import Tensor

from torchprt.errors import InputError

from .check import MeshReport, check
from .columns import zero_rows
from .normals import face_normals, unit, vertex_normals
from .tangents import orthogonal, smooth_tangents, tangents_from_uv
from .weld import join

Array = np.ndarray | Tensor

LARGEST = 1e150
"""Coordinates whose squares, and those of their differences, are still finite."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in the order of the file, no vertex dropped or merged. Made by `read_mesh` or `make_mesh`."""

    positions: Float64[Tensor, "V 3"]
    faces: Int64[Tensor, "F 3"]
    """Counter-clockwise seen from outside."""
    normals: Float64[Tensor, "V 3"]
    """Unit length; zero where a vertex has no usable normal."""
    colours: Float32[Tensor, "V 3"] | None
    """Linear RGB."""
    name: str
    report: MeshReport
    tangents: Float64[Tensor, "V 3"] | None = None
    """Unit length, orthogonal to the normals: those of the file, or the direction of increasing u. Zero where neither
    says one; None if that is everywhere, or if the file has no texture coordinates."""
    uv: Float64[Tensor, "F 3 2"] | None = None
    """Texture coordinates of every corner of every face; NaN where there are none, None if that is everywhere."""
    more_uv: Mapping[int, Float64[Tensor, "F 3 2"]] = field(default_factory=dict)
    """Further sets of them by their number, from 1."""
    v_up: bool = False
    """Whether v goes up from the lower edge of a picture, as in .obj, .ply and .usd; else down from the upper."""

    @property
    def uv_sets(self) -> list[int]:
        """The numbers of its sets of texture coordinates."""
        return sorted([*([] if self.uv is None else [0]), *self.more_uv])

    def uv_set(self, number: int) -> Float64[Tensor, "F 3 2"]:
        """A set of texture coordinates, v down whatever the file had. Raises InputError if there is none of that."""
        found = self.uv if number == 0 else self.more_uv.get(number)
        if found is None:
            known = ", ".join(map(str, self.uv_sets)) or "none"
            raise InputError(f"{self.name} has no set {number} of texture coordinates, it has {known}: use --uv unwrap")
        return torch.stack([found[..., 0], 1 - found[..., 1]], -1) if self.v_up else found

    @cached_property
    def tangent_field(self) -> Float64[Tensor, "V 3"]:
        """A unit tangent for every vertex, orthogonal to its normal: `tangents`, where they are missing a smooth field.

        Computed when first asked for; see `torchprt.scene.tangents.smooth_tangents`.
        """
        if self.tangents is not None and bool(self.tangents.any(dim=1).all()):
            return self.tangents
        guide = None if self.tangents is None else self.tangents.numpy()
        arrays = (self.positions.numpy(), self.faces.numpy(), self.normals.numpy())
        return torch.from_numpy(smooth_tangents(*arrays, guide))


def make_mesh(
    positions: Shaped[Array, "V 3"],
    faces: Shaped[Array, "F 3"],
    normals: Shaped[Array, "given 3"] | None = None,
    colours: Shaped[Array, "painted 3"] | None = None,
    name: str | os.PathLike[str] = "mesh",
    uv: Shaped[Array, "..."] | None = None,
    tangents: Shaped[Array, "turned 3"] | None = None,
    more_uv: Mapping[int, Shaped[Array, "..."]] = MappingProxyType({}),
    v_up: bool = False,
) -> Mesh:
    """A mesh of given triangles (numpy arrays or tensors of any real dtype), checked.

    Given normals are brought to unit length; where they are missing, zero or not finite, they are computed
    from the faces (see `vertex_normals`). Colours are linear RGB.

    `uv` are texture coordinates, [V, 2] or, a pair for every corner of every face, [F, 3, 2]; rows that are not
    finite are missing. They give the tangents, the directions of increasing u. Given `tangents` come first where they
    are usable. Only the direction of the tangent is taken: where texture coordinates are mirrored, the bitangent is
    still normal x tangent. `more_uv` are further sets of them, by their number from 1; `v_up`: whether v goes up.

    Raises InputError, naming `name`, if there are no faces, if a position is not finite, if all positions are zero,
    if a face names a vertex that does not exist, if no face has area, or if something has not a row for every vertex.
    """
    name = os.fspath(name)
    points = _numpy(positions, np.float64)
    triangles = _indices(faces, name)
    _refuse(points, triangles, name)
    joined = join(points, triangles)
    from_faces = vertex_normals(points, triangles, joined)
    given = np.zeros_like(points) if normals is None else unit(_numpy(normals, np.float64))
    if given.shape != points.shape:
        raise InputError(f"{name} has {len(given)} normals for {len(points)} vertices: give one a vertex")
    computed = zero_rows(given)
    final = np.where(computed[:, None], from_faces, given)
    linear = None if colours is None else torch.from_numpy(_numpy(colours, np.float32))
    if linear is not None and linear.shape != points.shape:
        raise InputError(f"{name} has {len(linear)} colours for {len(points)} vertices: give one a vertex")
    pairs = None if uv is None else _corner_uv(uv, points, triangles, name)
    directions = _tangents(points, triangles, final, pairs, tangents, name)
    report = check(points, triangles, final, computed, from_faces, joined)
    if directions is not None:
        report = replace(report, missing_tangents=int(np.all(directions == 0, axis=1).sum()))
    usable = directions is not None and directions.any()
    return Mesh(
        positions=torch.from_numpy(points),
        faces=torch.from_numpy(triangles),
        normals=torch.from_numpy(final),
        colours=linear,
        name=name,
        report=report,
        tangents=torch.from_numpy(directions) if usable and directions is not None else None,
        uv=None if pairs is None or not np.isfinite(pairs).any() else torch.from_numpy(pairs),
        more_uv={
            number: torch.from_numpy(_corner_uv(each, points, triangles, name)) for number, each in more_uv.items()
        },
        v_up=v_up,
    )


def _tangents(
    positions: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    normals: Float[np.ndarray, "V 3"],
    uv: Float[np.ndarray, "F 3 2"] | None,
    tangents: Array | None,
    name: str,
) -> Float[np.ndarray, "V 3"] | None:
    """Tangents as given, else from texture coordinates, else zero; None if there is neither."""
    if uv is None and tangents is None:
        return None
    result = np.zeros_like(positions)
    if uv is not None:
        result = tangents_from_uv(positions, faces, normals, uv)
    if tangents is not None:
        given = _numpy(tangents, np.float64)
        if given.shape != positions.shape:
            raise InputError(f"{name} has {len(given)} tangents for {len(positions)} vertices: give one a vertex")
        given = orthogonal(unit(given), normals)
        result = np.where(np.any(given != 0, axis=1)[:, None], given, result)
    return result


def _corner_uv(
    uv: Array, positions: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], name: str
) -> Float[np.ndarray, "F 3 2"]:
    pairs = _numpy(uv, np.float64)
    if pairs.shape == (len(positions), 2):
        pairs = pairs[faces]
    if pairs.shape != (len(faces), 3, 2):
        raise InputError(
            f"{name} has texture coordinates of shape {list(pairs.shape)} for {len(positions)} vertices and "
            f"{len(faces)} faces: give [V, 2] or [F, 3, 2]"
        )
    return pairs


def _numpy(values: Array, dtype: type) -> np.ndarray:
    array = values.detach().cpu().numpy() if isinstance(values, Tensor) else values
    # Out of range in float32 becomes infinite, and is refused where it matters.
    with np.errstate(over="ignore", invalid="ignore"):
        return np.array(array, dtype=dtype, order="C")


def _indices(faces: Array, name: str) -> np.ndarray:
    array = faces.detach().cpu().numpy() if isinstance(faces, Tensor) else np.asarray(faces)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"{name} has faces of {array.dtype}: give whole numbers, the indices of vertices from 0")
    return np.array(array, dtype=np.int64, order="C").reshape(-1, 3)


def _refuse(positions: Float[np.ndarray, "V 3"], faces: Shaped[np.ndarray, "F 3"], name: str) -> None:
    if not len(positions):
        raise InputError(f"{name} holds no vertices: give a mesh of triangles")
    if not len(faces):
        raise InputError(
            f"{name} holds {len(positions)} points and no faces: give a mesh of triangles, not a point cloud"
        )
    if not np.isfinite(positions).all():
        bad = ~np.isfinite(positions).all(axis=1)
        raise InputError(
            f"{name} has vertices that are not finite ({bad.sum()} in all), the first is vertex {bad.argmax()}: "
            "remove them or export the mesh again"
        )
    if np.abs(positions).max() > LARGEST:
        raise InputError(f"{name} has coordinates above {LARGEST:g}: scale the mesh down")
    if faces.min() < 0 or faces.max() >= len(positions):
        outside = ((faces < 0) | (faces >= len(positions))).any(axis=1)
        raise InputError(
            f"{name} has faces that name a vertex that does not exist ({outside.sum()} in all), the first is face "
            f"{outside.argmax()} {tuple(faces[outside.argmax()].tolist())} of {len(positions)} vertices: "
            "export the mesh again"
        )
    if not positions.any():
        raise InputError(
            f"{name} has all its vertices at zero, as a compressed file that was not decoded: "
            "export the mesh without compression"
        )
    # Exact zeros only: the report counts the faces that are merely thin. Most meshes pass at their first faces.
    if not any(face_normals(positions, some).any() for some in np.array_split(faces, len(faces) // 4096 + 1)):
        raise InputError(f"{name} has only faces without area: check the scale and the export of the mesh")
