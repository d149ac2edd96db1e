"""glTF 2.0: `Document` reads the container, `pieces` what its scene draws."""

from .gltf_document import Document
from .gltf_geometry import Piece, Pieces, Primitive, pieces, read_primitive

__all__ = ["Document", "Piece", "Pieces", "Primitive", "pieces", "read_primitive"]
