"""The run time: one `nn.Module` that adds layers, each of any signal. Needs torch alone."""

from .adaptive import Adapted, AdaptiveShader, Regions, adaptive
from .at_rest import at_rest
from .clustered import ClusteredSignal
from .composite import READINGS, Composite, Reading
from .dense import DenseSignal
from .display import agx, display, filmic, neutral, srgb, tone_mapped
from .environment import EnvironmentShader
from .eye_layer import ExitLayer, EyeLayerModule, FactoredLayer
from .fixed_light import FixedLightShader
from .fixed_orders import fixed_orders
from .incident import IncidentLayer, with_material
from .layer import DiffuseLayer, LayerModule, layer_module
from .light_field import under_field
from .local_light import LocalLightShader, local_light_shader
from .neighbourhood import NeighbourhoodShader, by_ratio
from .patch import lay, sample
from .patch_shader import PatchShader
from .phase import PhaseLayer
from .rays import pinhole
from .receiving import DIFFUSE, BrdfReceiving, PhongReceiving, Receiving
from .shader import Shader, shader
from .signal import Making, SignalModule, signal_module
from .visibility import VisibilityLayer
from .volume import VolumeShader
from .white import white
from .zonal import ZonalSignal

__all__ = [
    "DIFFUSE",
    "READINGS",
    "Adapted",
    "AdaptiveShader",
    "BrdfReceiving",
    "ClusteredSignal",
    "Composite",
    "DenseSignal",
    "DiffuseLayer",
    "EnvironmentShader",
    "ExitLayer",
    "EyeLayerModule",
    "FactoredLayer",
    "FixedLightShader",
    "IncidentLayer",
    "LayerModule",
    "LocalLightShader",
    "Making",
    "NeighbourhoodShader",
    "PatchShader",
    "PhaseLayer",
    "PhongReceiving",
    "Reading",
    "Receiving",
    "Regions",
    "Shader",
    "SignalModule",
    "VisibilityLayer",
    "VolumeShader",
    "ZonalSignal",
    "adaptive",
    "agx",
    "at_rest",
    "by_ratio",
    "display",
    "filmic",
    "fixed_orders",
    "lay",
    "layer_module",
    "local_light_shader",
    "neutral",
    "pinhole",
    "sample",
    "shader",
    "signal_module",
    "srgb",
    "tone_mapped",
    "under_field",
    "white",
    "with_material",
]
