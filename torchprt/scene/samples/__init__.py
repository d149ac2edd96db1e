"""Procedural scenes, the project's own: for demonstrations, tests and measurements."""

from .cloud import cloud
from .coloured_box import coloured_box
from .cylinder import cylinder
from .dish import dish
from .glider import glider, land, terrain
from .head import head
from .organic import organic
from .painted_vase import painted_vase, vase_picture, write_painted_vase
from .patches import bumps, waffle, wrinkles
from .plane_and_blocker import plane_and_blocker
from .ring import ring, ring_on_plane
from .room import room
from .still_life import still_life
from .teapot import teapot
from .vase import vase
from .wing import flap, wing, wing_rig, wing_translucency

__all__ = [
    "bumps",
    "cloud",
    "coloured_box",
    "cylinder",
    "dish",
    "flap",
    "glider",
    "head",
    "land",
    "organic",
    "painted_vase",
    "plane_and_blocker",
    "ring",
    "ring_on_plane",
    "room",
    "still_life",
    "teapot",
    "terrain",
    "vase",
    "vase_picture",
    "waffle",
    "wing",
    "wing_rig",
    "wing_translucency",
    "wrinkles",
    "write_painted_vase",
]
