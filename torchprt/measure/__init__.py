"""Error against a reference, time and bytes: what every approximation is judged by."""

from .error import ErrorReport, max_error, psnr, radiance_error, relative_rms, transfer_error
from .exit_radiance import exit_radiance, exit_radiance_by_brute_force, random_lights
from .frames import compare_frames
from .model import bake_recipe, frame_of, light_under, store_recipe
from .plan import Plan, plan
from .probe import Estimate, Probe
from .recipe import Recipe, read_recipe, write_recipe
from .sample import receivers_of, sample_receivers, sample_scene, sample_transfer
from .table import Row, Table
from .time import Timing, time_it

__all__ = [
    "ErrorReport",
    "Estimate",
    "Plan",
    "Probe",
    "Recipe",
    "Row",
    "Table",
    "Timing",
    "bake_recipe",
    "compare_frames",
    "exit_radiance",
    "exit_radiance_by_brute_force",
    "frame_of",
    "light_under",
    "max_error",
    "plan",
    "psnr",
    "radiance_error",
    "random_lights",
    "read_recipe",
    "receivers_of",
    "relative_rms",
    "sample_receivers",
    "sample_scene",
    "sample_transfer",
    "store_recipe",
    "time_it",
    "transfer_error",
    "write_recipe",
]
