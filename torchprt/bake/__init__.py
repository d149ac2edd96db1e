"""Embree bakes what light does on its way: each kind of transport, with progress, cancel and resume."""

from .bake import bake as bake
from .checkpoint import CheckpointWarning as CheckpointWarning
from .diffuse import unshadowed as unshadowed
from .directions import frames as frames
from .directions import hemisphere as hemisphere

__all__ = ["CheckpointWarning", "bake", "frames", "hemisphere", "unshadowed"]
