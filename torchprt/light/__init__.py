"""Light: environment images and analytic lights, as spherical-harmonic coefficients `[..., N, 3]`."""

from .analytic import constant as constant
from .analytic import directional as directional
from .analytic import disc as disc
from .analytic import hemisphere as hemisphere
from .analytic import sphere as sphere
from .coefficients import read_coefficients as read_coefficients
from .coefficients import write_coefficients as write_coefficients
from .damage import DamagedImageWarning as DamagedImageWarning
from .damage import ImageReport as ImageReport
from .damage import inspect as inspect
from .dominant import dominant as dominant
from .environment import cube_to_latlong as cube_to_latlong
from .environment import latlong_to_cube as latlong_to_cube
from .environment import project as project
from .image import read as read
from .image import read_with_report as read_with_report
from .sky import clear_sky as clear_sky
from .sky import clear_sky_radiance as clear_sky_radiance
from .sky import overcast_sky as overcast_sky
from .studio import studio as studio
from .sun import sun_radiance as sun_radiance

__all__ = [
    "DamagedImageWarning",
    "ImageReport",
    "clear_sky",
    "clear_sky_radiance",
    "constant",
    "cube_to_latlong",
    "directional",
    "disc",
    "dominant",
    "hemisphere",
    "inspect",
    "latlong_to_cube",
    "overcast_sky",
    "project",
    "read",
    "read_coefficients",
    "read_with_report",
    "sphere",
    "studio",
    "sun_radiance",
    "write_coefficients",
]
