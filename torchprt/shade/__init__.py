"""The run time: an `nn.Module` per kind of transfer. Needs torch alone."""

from .diffuse import DiffuseShader as DiffuseShader
from .display import display as display
from .display import filmic as filmic
from .display import srgb as srgb
from .graph import EnvironmentShader as EnvironmentShader
from .shader import shader as shader

__all__ = ["DiffuseShader", "EnvironmentShader", "display", "filmic", "shader", "srgb"]
