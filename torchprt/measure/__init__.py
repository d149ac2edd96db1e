"""Error against a reference, time and bytes: what every approximation is judged by."""

from .error import ErrorReport, max_error, psnr, radiance_error, relative_rms, transfer_error
from .exit_radiance import exit_radiance, exit_radiance_by_brute_force, random_lights
from .frames import compare_frames
from .front import Halved, Point
from .model import bake_recipe, frame_of, light_under, store_recipe
from .plan import Plan, plan
from .probe import Estimate, Probe
from .recipe import Recipe, read_recipe, write_recipe
from .recipe_error import error_under, errors_under
from .sample import receivers_of, sample_receivers, sample_scene, sample_transfer
from .table import Row, Table
from .time import Timing, time_it
from .tradeoff import Tradeoff, tradeoff
from .tradeoff_files import save_tradeoff

__all__ = [
    "ErrorReport",
    "Estimate",
    "Halved",
    "Plan",
    "Point",
    "Probe",
    "Recipe",
    "Row",
    "Table",
    "Timing",
    "Tradeoff",
    "bake_recipe",
    "compare_frames",
    "error_under",
    "errors_under",
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
    "save_tradeoff",
    "store_recipe",
    "time_it",
    "tradeoff",
    "transfer_error",
    "write_recipe",
]
