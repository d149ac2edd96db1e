"""The run time: an `nn.Module` per kind of transfer. Needs torch alone."""

from .clustered import ClusteredGlossyShader as ClusteredGlossyShader
from .clustered import ClusteredShader as ClusteredShader
from .diffuse import DiffuseShader as DiffuseShader
from .display import display as display
from .display import filmic as filmic
from .display import srgb as srgb
from .fixed import FixedEyeShader as FixedEyeShader
from .fixed import FixedLightShader as FixedLightShader
from .glossy import FactoredShader as FactoredShader
from .glossy import GlossyShader as GlossyShader
from .graph import EnvironmentShader as EnvironmentShader
from .incident import IncidentShader as IncidentShader
from .incident import with_material as with_material
from .shader import Shader as Shader
from .shader import shader as shader
from .view import ViewShader as ViewShader
from .visibility import VisibilityShader as VisibilityShader

__all__ = [
    "ClusteredGlossyShader",
    "ClusteredShader",
    "DiffuseShader",
    "EnvironmentShader",
    "FactoredShader",
    "FixedEyeShader",
    "FixedLightShader",
    "GlossyShader",
    "IncidentShader",
    "Shader",
    "ViewShader",
    "VisibilityShader",
    "display",
    "filmic",
    "shader",
    "srgb",
    "with_material",
]
