"""Scenes: meshes read and checked, their materials, what they do, and procedural samples."""

from . import samples as samples
from .check import MeshReport as MeshReport
from .energy import EnergyWarning as EnergyWarning
from .geometry import Geometry as Geometry
from .material import Material as Material
from .material_file import read_material as read_material
from .mesh import Mesh as Mesh
from .mesh import make_mesh as make_mesh
from .object import Object as Object
from .object import TangentWarning as TangentWarning
from .points import Points as Points
from .reading import read_mesh as read_mesh
from .scene import Requirements as Requirements
from .scene import Scene as Scene
from .scene import load as load

__all__ = [
    "EnergyWarning",
    "Geometry",
    "Material",
    "Mesh",
    "MeshReport",
    "Object",
    "Points",
    "Requirements",
    "Scene",
    "TangentWarning",
    "load",
    "make_mesh",
    "read_material",
    "read_mesh",
    "samples",
]
