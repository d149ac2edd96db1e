"""Precomputed radiance transfer for PyTorch: bake once, relight in real time, export to ONNX.

    import torchprt as prt

    scene = prt.load("bunny.ply", albedo=0.5)
    transfer = prt.bake(scene, order=5, rays=1024, bounces=2)
    shade = prt.shader(transfer)
    radiance = shade(prt.light.project(prt.light.read("park.exr"), order=5))  # [V, 3], linear

Rooms are imported when they are first used, so that shading alone never loads a tracer or a mesh library.
"""

import importlib
from typing import TYPE_CHECKING, Any

from .errors import InputError as InputError
from .version import VERSION as __version__

if TYPE_CHECKING:
    from . import brdf as brdf
    from . import compression as compression
    from . import light as light
    from . import measure as measure
    from . import onnx as onnx
    from . import pose as pose
    from . import preview as preview
    from . import scene as scene
    from . import sh as sh
    from . import shade as shade
    from . import transfer as transfer
    from . import transport as transport
    from . import web as web
    from .compression import compress as compress
    from .measure import plan as plan
    from .transport import bake as bake

_ROOMS = (
    "brdf",
    "compression",
    "light",
    "measure",
    "onnx",
    "pose",
    "preview",
    "scene",
    "sh",
    "shade",
    "trace",
    "transfer",
    "transport",
    "web",
)
_NAMES = {
    "load": "scene",
    "Scene": "scene",
    "Object": "scene",
    "Material": "scene",
    "Points": "scene",
    "samples": "scene",
    "shader": "shade",
    "bake": "transport",
    "compress": "compression",
    "plan": "measure",
    "Transfer": "transfer",
    "load_transfer": "transfer",
    "save_transfer": "transfer",
}
__all__ = ["InputError", "__version__", *_ROOMS, *_NAMES]


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return importlib.import_module(f"torchprt.{name}")
    if name in _NAMES:
        return getattr(importlib.import_module(f"torchprt.{_NAMES[name]}"), name.removesuffix("_transfer"))
    raise AttributeError(f"module 'torchprt' has no attribute '{name}'")


def load_ipython_extension(shell: Any) -> None:
    """`%load_ext torchprt`: transfers and lights of a notebook are shown as pictures (see docs/guide.md)."""
    from .notebook import load_ipython_extension

    load_ipython_extension(shell)


def unload_ipython_extension(shell: Any) -> None:
    """`%unload_ext torchprt`."""
    from .notebook import unload_ipython_extension

    unload_ipython_extension(shell)


def __dir__() -> list[str]:
    return sorted(__all__)
