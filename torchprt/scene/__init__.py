"""Scenes: meshes read and checked, their materials, what they do, and procedural samples."""

from . import samples
from .charts import AtlasWarning
from .check import MeshReport
from .deform import bend, twist
from .dress import file_material, object_of
from .energy import EnergyWarning
from .geometry import Geometry
from .glosses import Glosses
from .height_field import height_field, read_heights, tiled
from .lightmap import Lightmap
from .material import Material
from .material_file import read_material
from .mesh import Mesh, make_mesh
from .object import Object, SubsurfaceWarning, TangentWarning
from .paint import Paint
from .points import Points
from .reading import read_mesh
from .rig import Rig
from .scene import Requirements, Scene, is_scene, load, load_objects, mirror_of
from .scene_file import read_scene
from .subsurface import MATERIALS, Subsurface, read_subsurface
from .surface import Look, Surface, read_surface, texture_albedo
from .volume import Volume
from .volume_reading import read_volume

__all__ = [
    "MATERIALS",
    "AtlasWarning",
    "EnergyWarning",
    "Geometry",
    "Glosses",
    "Lightmap",
    "Look",
    "Material",
    "Mesh",
    "MeshReport",
    "Object",
    "Paint",
    "Points",
    "Requirements",
    "Rig",
    "Scene",
    "Subsurface",
    "SubsurfaceWarning",
    "Surface",
    "TangentWarning",
    "Volume",
    "bend",
    "file_material",
    "height_field",
    "is_scene",
    "load",
    "load_objects",
    "make_mesh",
    "mirror_of",
    "object_of",
    "read_heights",
    "read_material",
    "read_mesh",
    "read_scene",
    "read_subsurface",
    "read_surface",
    "read_volume",
    "samples",
    "texture_albedo",
    "tiled",
    "twist",
]
