"""Rays against triangles: Embree through embreex, and nothing of transfer."""

from .mirrors import REFLECTIONS, Mirrors, Reflected, follow
from .tracer import OFFSET, Hits, Spot, Tracer, starts

__all__ = ["OFFSET", "REFLECTIONS", "Hits", "Mirrors", "Reflected", "Spot", "Tracer", "follow", "starts"]
