"""A baked model as a folder that any static web server shows, with no Python behind it."""

from .environment import samples
from .export import PageReport, export
from .flight import Flight
from .libraries import libraries
from .serve import serve
from .shader_file import ShaderFile, shader_file
from .three import ThreeReport, export_three, module

__all__ = [
    "Flight",
    "PageReport",
    "ShaderFile",
    "ThreeReport",
    "export",
    "export_three",
    "libraries",
    "module",
    "samples",
    "serve",
    "shader_file",
]
