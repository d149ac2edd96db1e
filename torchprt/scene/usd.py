"""OpenUSD: the triangles that a stage draws at rest, by Pixar's own library."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from torchprt.errors import InputError


class UsdMesh(NamedTuple):
    """A mesh of a stage, in the world, y up. A vertex with several normals is repeated beside itself, once for each."""

    positions: Float64[np.ndarray, "V 3"]
    faces: Int64[np.ndarray, "F 3"]
    normals: Float64[np.ndarray, "V 3"] | None
    colours: Float64[np.ndarray, "V 3"] | None
    """Linear RGB."""
    uv: Float64[np.ndarray, "F 3 2"] | None


def read_usd(source: Path) -> tuple[list[UsdMesh], list[str]]:
    """The meshes of a .usd, .usda, .usdc or .usdz file in the order of its tree, and what was left out, in sentences.

    What is drawn: visible meshes for no purpose or to render, also of references and instances, at the first time
    that the file has. Polygons become triangles; surfaces are not subdivided; skeletons and materials are not read.
    Raises InputError if the package `usd-core` is not installed or the file cannot be opened.
    """
    try:
        from pxr import Tf, Usd, UsdGeom
    except ImportError as fault:
        raise InputError(
            f"{source} needs the package usd-core to be read: install torchprt[usd], or export the mesh as .glb"
        ) from fault
    try:
        # It would tell the console what the exception says.
        with Tf.DiagnosticTrap():
            stage = Usd.Stage.Open(str(source))
    except Tf.ErrorException as fault:
        raise InputError(f"{source} is damaged or no USD file: export it again") from fault
    time = Usd.TimeCode.EarliestTime()
    place = UsdGeom.XformCache(time)
    upright = np.eye(3)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        upright = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    found, left = [], 0
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Gprim) or prim.IsA(UsdGeom.PointInstancer):
            imageable = UsdGeom.Imageable(prim)
            hidden = imageable.ComputeVisibility(time) == UsdGeom.Tokens.invisible
            if hidden or imageable.ComputePurpose() in (UsdGeom.Tokens.guide, UsdGeom.Tokens.proxy):
                continue
            if not prim.IsA(UsdGeom.Mesh):
                left += 1
                continue
            # For rows, as everything of USD.
            matrix = np.array(place.GetLocalToWorldTransform(prim))
            found.append(_mesh(source, UsdGeom.Mesh(prim), time, matrix[:3, :3].T, matrix[3, :3], upright))
    noun = "object that is" if left == 1 else "objects that are"
    return found, [f"{left} {noun} no mesh left out."] if left else []


def _mesh(source: Path, mesh: Any, time: Any, linear: np.ndarray, shift: np.ndarray, upright: np.ndarray) -> UsdMesh:
    from pxr import UsdGeom

    name = mesh.GetPath()
    points = np.array(mesh.GetPointsAttr().Get(time), np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(time), np.int64).reshape(-1)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(time), np.int64).reshape(-1)
    if counts.sum() != len(corners) or (counts < 3).any():
        raise InputError(f"{source} has faces of {name} without all their corners: export it again")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise InputError(f"{source} has a face of {name} that names vertex {corners.max()} of {len(points)}")
    holes = np.array(mesh.GetHoleIndicesAttr().Get(time) or [], np.int64)
    of_corner, of_face = np.arange(len(corners)), np.repeat(np.arange(len(counts)), counts)

    def values(primvar: Any, own: Any = None, interpolation: str = "") -> tuple[np.ndarray, str] | None:
        """What a primvar, or else an attribute, has for each of its elements, and what they are."""
        if primvar and primvar.HasValue():
            own, interpolation = primvar.ComputeFlattened(time), primvar.GetInterpolation()
        return None if own is None else (np.array(own, np.float64).reshape(len(own), -1), interpolation)

    def at_corners(given: tuple[np.ndarray, str] | None) -> np.ndarray | None:
        if given is None:
            return None
        rows = {"vertex": corners, "varying": corners, "faceVarying": of_corner, "uniform": of_face}
        which = rows.get(given[1], np.zeros_like(corners))
        if len(which) and which.max() >= len(given[0]):
            raise InputError(f"{source} has {len(given[0])} values on {name}, fewer than it needs: export it again")
        result: np.ndarray = given[0][which]
        return result

    known = UsdGeom.PrimvarsAPI(mesh)
    normals = at_corners(
        values(known.GetPrimvar("normals"), mesh.GetNormalsAttr().Get(time), mesh.GetNormalsInterpolation())
    )
    colours = at_corners(values(known.GetPrimvar("displayColor")))
    uv = next(
        (found for key in ("st", "st0", "UVMap", "uv") if (found := values(known.GetPrimvar(key))) is not None), None
    )
    pairs = at_corners(uv)
    # A vertex for each normal that one has; those that no face names stay.
    order = np.zeros(len(corners), np.int64)
    if normals is not None:
        order = np.unique(normals, axis=0, return_inverse=True)[1].reshape(-1)
    unused = np.setdiff1d(np.arange(len(points)), corners)
    every = np.concatenate([np.stack([corners, order], 1), np.stack([unused, 0 * unused], 1)])
    kinds, place = np.unique(every, axis=0, return_inverse=True)
    place = place.reshape(-1)[: len(corners)]
    triangles = _fans(counts, holes)
    mirrored = np.linalg.det(linear) < 0
    if mirrored != (mesh.GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded):
        triangles = triangles[:, ::-1]

    def of_vertex(given: np.ndarray | None) -> np.ndarray | None:
        if given is None:
            return None
        result = np.zeros((len(kinds), given.shape[1]))
        result[place] = given
        return result

    linear, shift = upright @ linear, upright @ shift
    turned = of_vertex(normals)
    if turned is not None:
        x, y, z = linear
        turned = turned @ np.stack([np.cross(y, z), np.cross(z, x), np.cross(x, y)]).T * (-1 if mirrored else 1)
    return UsdMesh(
        points[kinds[:, 0]] @ linear.T + shift,
        place[triangles],
        turned,
        of_vertex(colours),
        None if pairs is None else pairs[:, :2][triangles],
    )


def _fans(counts: Int64[np.ndarray, "P"], holes: Int64[np.ndarray, "H"]) -> Int64[np.ndarray, "F 3"]:
    """Corners of the triangles that polygons of these many corners, one after the other, become."""
    starts = np.cumsum(counts) - counts
    shown = np.setdiff1d(np.arange(len(counts)), holes)
    number = np.repeat(shown, counts[shown] - 2)
    step = np.arange(len(number)) - np.repeat(np.cumsum(counts[shown] - 2) - (counts[shown] - 2), counts[shown] - 2)
    return np.stack([starts[number], starts[number] + step + 1, starts[number] + step + 2], axis=1)
