"""Procedural scenes, the project's own: for demonstrations, tests and measurements."""

from .coloured_box import coloured_box as coloured_box
from .cylinder import cylinder as cylinder
from .dish import dish as dish
from .head import head as head
from .organic import organic as organic
from .patches import bumps as bumps
from .patches import waffle as waffle
from .patches import wrinkles as wrinkles
from .plane_and_blocker import plane_and_blocker as plane_and_blocker
from .teapot import teapot as teapot
from .vase import vase as vase
from .wing import flap as flap
from .wing import wing as wing
from .wing import wing_rig as wing_rig
from .wing import wing_translucency as wing_translucency

__all__ = [
    "bumps",
    "coloured_box",
    "cylinder",
    "dish",
    "flap",
    "head",
    "organic",
    "plane_and_blocker",
    "teapot",
    "vase",
    "waffle",
    "wing",
    "wing_rig",
    "wing_translucency",
    "wrinkles",
]
