"""Compressed glTF: buffer views of meshopt and primitives of Draco, by the libraries that define them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from torchprt.errors import InputError

MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
DRACO = "KHR_draco_mesh_compression"


def decode_meshopt(data: bytes, packed: Mapping[str, Any], source: Path) -> bytes:
    """The bytes of a buffer view that `packed`, its extension, describes; filters are undone.

    Raises InputError if the data are damaged or the decoder is not installed.
    Source: EXT_meshopt_compression.
    """
    try:
        import meshopt
    except ImportError as fault:
        raise InputError(
            f"{source} is compressed with meshopt, and the package meshopt, which decodes it, is not installed (it "
            "needs Python 3.11): install it, or export the mesh without compression"
        ) from fault
    count, stride = packed["count"], packed["byteStride"]
    # The declared size is made before anything is decoded; nothing is packed to less than a part in 2^15.
    if count * stride > max(len(data), 1) << 15:
        raise InputError(f"{source} has damaged meshopt data of {count} elements: export the mesh again")
    try:
        rows = meshopt.decode_gltf_buffer(data, count, stride, packed["mode"], packed.get("filter", "NONE"))
    except (ValueError, RuntimeError) as fault:
        raise InputError(f"{source} has damaged meshopt data ({fault}): export the mesh again") from fault
    return np.ascontiguousarray(rows).tobytes()


class Decoded(NamedTuple):
    """A primitive as Draco holds it."""

    attributes: dict[int, np.ndarray]
    """Values `[V, width]` under their unique ids, as numbers of the type in the file."""
    indices: np.ndarray
    """Of triangles, flat."""


def decode_draco(data: bytes, source: Path) -> Decoded:
    """The attributes and triangles of a Draco mesh.

    Raises InputError if the data are damaged, hold no mesh, or if the decoder is not installed.
    """
    try:
        import DracoPy
    except ImportError as fault:
        raise InputError(
            f"{source} is compressed with Draco, and the package DracoPy, which decodes it, is not installed: install "
            "it, or export the mesh without compression"
        ) from fault
    try:
        mesh = DracoPy.decode(data)
    except Exception as fault:  # It has exceptions of its own, and of C++.
        raise InputError(f"{source} has damaged Draco data ({fault}): export the mesh again") from fault
    if not isinstance(mesh, DracoPy.DracoMesh):
        raise InputError(f"{source} has Draco data of points, not of a mesh: export the mesh again")
    attributes = {each["unique_id"]: _signed(np.asarray(each["data"]), each["data_type"]) for each in mesh.attributes}
    return Decoded(attributes, np.asarray(mesh.faces, np.int64).reshape(-1))


def _signed(values: np.ndarray, kind: int) -> np.ndarray:
    """Draco's types 1, 3 and 5 are signed; DracoPy hands whole numbers on as unsigned."""
    signed = {1: np.int8, 3: np.int16, 5: np.int32}.get(int(kind))
    unsigned = signed is not None and np.issubdtype(values.dtype, np.unsignedinteger)
    return values.astype(signed) if unsigned and signed is not None else values
