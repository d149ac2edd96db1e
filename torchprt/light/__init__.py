"""Light: environment images and analytic lights, as spherical-harmonic coefficients `[..., N, 3]`."""

from .damage import DamagedImageWarning as DamagedImageWarning
from .damage import ImageReport as ImageReport
from .damage import inspect as inspect
from .image import read as read
from .image import read_with_report as read_with_report

__all__ = ["DamagedImageWarning", "ImageReport", "inspect", "read", "read_with_report"]
