"""Embree bakes what light does on its way: each kind of transport, with progress, cancel and resume.

The room is called like its verb: `torchprt.bake(scene)` is `torchprt.bake.bake(scene)`.
"""

import sys
import types
from typing import Any

from .bake import bake as bake
from .bake_glossy import OrderWarning as OrderWarning
from .checkpoint import CheckpointWarning as CheckpointWarning
from .diffuse import unshadowed as unshadowed
from .directions import frames as frames
from .directions import hemisphere as hemisphere

__all__ = ["CheckpointWarning", "OrderWarning", "bake", "frames", "hemisphere", "unshadowed"]


class _Verb(types.ModuleType):
    """Importing a room puts it under its name in `torchprt`, over any function of that name: so it is callable."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return bake(*arguments, **options)


sys.modules[__name__].__class__ = _Verb
