"""The run time: one `nn.Module` that adds layers, each of any signal. Needs torch alone."""

from .at_rest import at_rest as at_rest
from .clustered import ClusteredSignal as ClusteredSignal
from .dense import DenseSignal as DenseSignal
from .display import display as display
from .display import filmic as filmic
from .display import srgb as srgb
from .environment import EnvironmentShader as EnvironmentShader
from .eye_layer import ExitLayer as ExitLayer
from .eye_layer import EyeLayerModule as EyeLayerModule
from .eye_layer import FactoredLayer as FactoredLayer
from .fixed_light import FixedLightShader as FixedLightShader
from .frames import DeformedFrames as DeformedFrames
from .frames import deformed_frames as deformed_frames
from .frames import nearest_rotation as nearest_rotation
from .incident import IncidentLayer as IncidentLayer
from .incident import with_material as with_material
from .layer import DiffuseLayer as DiffuseLayer
from .layer import LayerModule as LayerModule
from .layer import layer_module as layer_module
from .patch import lay as lay
from .patch import sample as sample
from .patch import surface_frames as surface_frames
from .shader import Shader as Shader
from .shader import shader as shader
from .signal import SignalModule as SignalModule
from .signal import signal_module as signal_module
from .skin import SkinnedMesh as SkinnedMesh
from .visibility import VisibilityLayer as VisibilityLayer
from .zonal import ZonalSignal as ZonalSignal

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
