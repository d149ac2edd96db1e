"""Error against a reference, time and bytes: what every approximation is judged by."""

from .error import ErrorReport as ErrorReport
from .error import max_error as max_error
from .error import psnr as psnr
from .error import radiance_error as radiance_error
from .error import relative_rms as relative_rms
from .error import transfer_error as transfer_error
from .table import Row as Row
from .table import Table as Table
from .time import Timing as Timing
from .time import time_it as time_it

__all__ = [
    "ErrorReport",
    "Row",
    "Table",
    "Timing",
    "max_error",
    "psnr",
    "radiance_error",
    "relative_rms",
    "time_it",
    "transfer_error",
]
