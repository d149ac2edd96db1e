"""Error against a reference, time and bytes: what every approximation is judged by."""

from .error import ErrorReport, max_error, psnr, radiance_error, relative_rms, transfer_error
from .exit_radiance import exit_radiance, exit_radiance_by_brute_force, random_lights
from .frames import compare_frames
from .sample import sample_receivers, sample_transfer
from .table import Row, Table
from .time import Timing, time_it

__all__ = [
    "ErrorReport",
    "Row",
    "Table",
    "Timing",
    "compare_frames",
    "exit_radiance",
    "exit_radiance_by_brute_force",
    "max_error",
    "psnr",
    "radiance_error",
    "random_lights",
    "relative_rms",
    "sample_receivers",
    "sample_transfer",
    "time_it",
    "transfer_error",
]
