"""Meshes in motion: the frames of a deformed surface, skinning, tangent frames. Needs torch alone."""

from .frames import DeformedFrames, deformed_frames, nearest_rotation
from .skin import SkinnedMesh
from .surface_frames import surface_frames

__all__ = ["DeformedFrames", "SkinnedMesh", "deformed_frames", "nearest_rotation", "surface_frames"]
