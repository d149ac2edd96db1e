"""Scenes: meshes read and checked, their materials, what they do, and procedural samples."""

from . import samples as samples
from .check import MeshReport as MeshReport
from .deform import bend as bend
from .deform import twist as twist
from .energy import EnergyWarning as EnergyWarning
from .geometry import Geometry as Geometry
from .height_field import height_field as height_field
from .height_field import read_heights as read_heights
from .height_field import tiled as tiled
from .material import Material as Material
from .material_file import read_material as read_material
from .mesh import Mesh as Mesh
from .mesh import make_mesh as make_mesh
from .object import Object as Object
from .object import TangentWarning as TangentWarning
from .points import Points as Points
from .reading import read_mesh as read_mesh
from .rig import Rig as Rig
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
    "samples",
    "tiled",
    "twist",
]
