"""Rays against triangles: Embree, a ray or a packet of rays at a time, and nothing of transfer."""

from .engines import ENGINE, EngineWarning
from .hits import Hits
from .mirrors import REFLECTIONS, Mirrors, Reflected, follow
from .rays import starts
from .tracer import OFFSET, Spot, Tracer

__all__ = [
    "ENGINE",
    "OFFSET",
    "REFLECTIONS",
    "EngineWarning",
    "Hits",
    "Mirrors",
    "Reflected",
    "Spot",
    "Tracer",
    "follow",
    "starts",
]
