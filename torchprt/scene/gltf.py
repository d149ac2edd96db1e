"""glTF 2.0: `Document` reads the container, `pieces` what its scene draws."""

from .gltf_decode import DRACO, MESHOPT, decode_draco
from .gltf_document import Document, as_declared
from .gltf_geometry import Piece, Pieces, Primitive, pieces, read_primitive
from .gltf_nodes import INSTANCING, Nodes

__all__ = [
    "DRACO",
    "INSTANCING",
    "MESHOPT",
    "Document",
    "Nodes",
    "Piece",
    "Pieces",
    "Primitive",
    "as_declared",
    "decode_draco",
    "pieces",
    "read_primitive",
]
