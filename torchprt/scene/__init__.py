"""Scenes: meshes read and checked, their materials, what they do, and procedural samples."""

from typing import TYPE_CHECKING

from torchprt.lazily import lazily

if TYPE_CHECKING:
    from . import samples as samples
    from .charts import AtlasWarning as AtlasWarning
    from .check import MeshReport as MeshReport
    from .deform import bend as bend
    from .deform import twist as twist
    from .dress import file_material as file_material
    from .dress import object_of as object_of
    from .energy import EnergyWarning as EnergyWarning
    from .geometry import Geometry as Geometry
    from .glosses import Glosses as Glosses
    from .height_fields import height_field as height_field
    from .height_fields import read_heights as read_heights
    from .height_fields import tiled as tiled
    from .lightmap import Lightmap as Lightmap
    from .material import Material as Material
    from .material_file import read_material as read_material
    from .mesh import Mesh as Mesh
    from .mesh import make_mesh as make_mesh
    from .object import Object as Object
    from .object import SubsurfaceWarning as SubsurfaceWarning
    from .object import TangentWarning as TangentWarning
    from .paint import Paint as Paint
    from .points import Points as Points
    from .reading import read_mesh as read_mesh
    from .rig import Rig as Rig
    from .scene import Requirements as Requirements
    from .scene import Scene as Scene
    from .scene import is_scene as is_scene
    from .scene import load as load
    from .scene import load_objects as load_objects
    from .scene import mirror_of as mirror_of
    from .scene_file import read_scene as read_scene
    from .subsurface import MATERIALS as MATERIALS
    from .subsurface import Subsurface as Subsurface
    from .subsurface import read_subsurface as read_subsurface
    from .surface import Look as Look
    from .surface import Surface as Surface
    from .surface import read_surface as read_surface
    from .surface import texture_albedo as texture_albedo
    from .volume import Volume as Volume
    from .volume_reading import read_volume as read_volume

_NAMES = {
    "AtlasWarning": "charts",
    "EnergyWarning": "energy",
    "Geometry": "geometry",
    "Glosses": "glosses",
    "Lightmap": "lightmap",
    "Look": "surface",
    "MATERIALS": "subsurface",
    "Material": "material",
    "Mesh": "mesh",
    "MeshReport": "check",
    "Object": "object",
    "Paint": "paint",
    "Points": "points",
    "Requirements": "scene",
    "Rig": "rig",
    "Scene": "scene",
    "Subsurface": "subsurface",
    "SubsurfaceWarning": "object",
    "Surface": "surface",
    "TangentWarning": "object",
    "Volume": "volume",
    "bend": "deform",
    "file_material": "dress",
    "height_field": "height_fields",
    "is_scene": "scene",
    "load": "scene",
    "load_objects": "scene",
    "make_mesh": "mesh",
    "mirror_of": "scene",
    "object_of": "dress",
    "read_heights": "height_fields",
    "read_material": "material_file",
    "read_mesh": "reading",
    "read_scene": "scene_file",
    "read_subsurface": "subsurface",
    "read_surface": "surface",
    "read_volume": "volume_reading",
    "samples": "samples",
    "texture_albedo": "surface",
    "tiled": "height_fields",
    "twist": "deform",
}
__all__ = [*_NAMES]
__getattr__, __dir__ = lazily(__name__, _NAMES)
