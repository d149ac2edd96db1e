"""The run time: one `nn.Module` that adds layers, each of any signal. Needs torch alone."""

from .at_rest import at_rest
from .clustered import ClusteredSignal
from .dense import DenseSignal
from .display import display, filmic, srgb
from .environment import EnvironmentShader
from .eye_layer import ExitLayer, EyeLayerModule, FactoredLayer
from .fixed_light import FixedLightShader
from .frames import DeformedFrames, deformed_frames, nearest_rotation
from .incident import IncidentLayer, with_material
from .layer import DiffuseLayer, LayerModule, layer_module
from .patch import lay, sample, surface_frames
from .shader import Shader, shader
from .signal import SignalModule, signal_module
from .skin import SkinnedMesh
from .visibility import VisibilityLayer
from .zonal import ZonalSignal

__all__ = [
    "ClusteredSignal",
    "DeformedFrames",
    "DenseSignal",
    "DiffuseLayer",
    "EnvironmentShader",
    "ExitLayer",
    "EyeLayerModule",
    "FactoredLayer",
    "FixedLightShader",
    "IncidentLayer",
    "LayerModule",
    "Shader",
    "SignalModule",
    "SkinnedMesh",
    "VisibilityLayer",
    "ZonalSignal",
    "at_rest",
    "deformed_frames",
    "display",
    "filmic",
    "lay",
    "layer_module",
    "nearest_rotation",
    "sample",
    "shader",
    "signal_module",
    "srgb",
    "surface_frames",
    "with_material",
]
