"""The run time: an `nn.Module` per kind of transfer. Needs torch alone."""

from .clustered import ClusteredFactoredShader as ClusteredFactoredShader
from .clustered import ClusteredGlossyShader as ClusteredGlossyShader
from .clustered import ClusteredIncidentShader as ClusteredIncidentShader
from .clustered import ClusteredShader as ClusteredShader
from .clustered import ClusteredVisibilityShader as ClusteredVisibilityShader
from .deformable import DeformableShader as DeformableShader
from .deformable import FixedPoseShader as FixedPoseShader
from .deformable_glossy import DeformableFactoredShader as DeformableFactoredShader
from .diffuse import DiffuseShader as DiffuseShader
from .display import display as display
from .display import filmic as filmic
from .display import srgb as srgb
from .fixed import FixedEyeShader as FixedEyeShader
from .fixed import FixedLightShader as FixedLightShader
from .frames import DeformedFrames as DeformedFrames
from .frames import deformed_frames as deformed_frames
from .frames import nearest_rotation as nearest_rotation
from .glossy import FactoredShader as FactoredShader
from .glossy import GlossyShader as GlossyShader
from .graph import EnvironmentShader as EnvironmentShader
from .incident import IncidentShader as IncidentShader
from .incident import with_material as with_material
from .patch import lay as lay
from .patch import sample as sample
from .patch import surface_frames as surface_frames
from .shader import Shader as Shader
from .shader import shader as shader
from .skin import SkinnedMesh as SkinnedMesh
from .view import ViewShader as ViewShader
from .visibility import VisibilityShader as VisibilityShader

__all__ = [
    "ClusteredFactoredShader",
    "ClusteredGlossyShader",
    "ClusteredIncidentShader",
    "ClusteredShader",
    "ClusteredVisibilityShader",
    "DeformableFactoredShader",
    "DeformableShader",
    "DeformedFrames",
    "DiffuseShader",
    "EnvironmentShader",
    "FactoredShader",
    "FixedEyeShader",
    "FixedLightShader",
    "FixedPoseShader",
    "GlossyShader",
    "IncidentShader",
    "Shader",
    "SkinnedMesh",
    "ViewShader",
    "VisibilityShader",
    "deformed_frames",
    "display",
    "filmic",
    "lay",
    "nearest_rotation",
    "sample",
    "shader",
    "srgb",
    "surface_frames",
    "with_material",
]
