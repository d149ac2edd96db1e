"""Error against a reference, time and bytes: what every approximation is judged by."""

from .error import ErrorReport as ErrorReport
from .error import max_error as max_error
from .error import psnr as psnr
from .error import radiance_error as radiance_error
from .error import relative_rms as relative_rms
from .error import transfer_error as transfer_error
from .exit_radiance import exit_radiance as exit_radiance
from .exit_radiance import exit_radiance_by_brute_force as exit_radiance_by_brute_force
from .exit_radiance import random_lights as random_lights
from .frames import compare_frames as compare_frames
from .sample import sample_receivers as sample_receivers
from .sample import sample_transfer as sample_transfer
from .table import Row as Row
from .table import Table as Table
from .time import Timing as Timing
from .time import time_it as time_it

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
