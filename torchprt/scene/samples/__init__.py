"""Procedural scenes, the project's own: for demonstrations, tests and measurements."""

from .coloured_box import coloured_box as coloured_box
from .dish import dish as dish
from .organic import organic as organic
from .plane_and_blocker import plane_and_blocker as plane_and_blocker
from .teapot import teapot as teapot

__all__ = ["coloured_box", "dish", "organic", "plane_and_blocker", "teapot"]
