"""Scenes: meshes read and checked, their materials, what they do, and procedural samples."""

from . import samples
from .check import MeshReport
from .deform import bend, twist
from .energy import EnergyWarning
from .geometry import Geometry
from .height_field import height_field, read_heights, tiled
from .material import Material
from .material_file import read_material
from .mesh import Mesh, make_mesh
from .object import Object, TangentWarning
from .points import Points
from .reading import read_mesh
from .rig import Rig
from .scene import Requirements, Scene, load
from .scene_file import read_scene

__all__ = [
    "EnergyWarning",
    "Geometry",
    "Material",
    "Mesh",
    "MeshReport",
    "Object",
    "Points",
    "Requirements",
    "Rig",
    "Scene",
    "TangentWarning",
    "bend",
    "height_field",
    "load",
    "make_mesh",
    "read_heights",
    "read_material",
    "read_mesh",
    "read_scene",
    "samples",
    "tiled",
    "twist",
]
