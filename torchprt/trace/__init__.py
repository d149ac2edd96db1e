"""Rays against triangles: Embree through embreex, and nothing of transfer."""

from .tracer import OFFSET, Hits, Tracer

__all__ = ["OFFSET", "Hits", "Tracer"]
