"""Rays against triangles: Embree through embreex, and nothing of transfer."""

from .tracer import OFFSET as OFFSET
from .tracer import Hits as Hits
from .tracer import Tracer as Tracer

__all__ = ["OFFSET", "Hits", "Tracer"]
