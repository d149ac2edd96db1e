"""Light: environment images and analytic lights, as spherical-harmonic coefficients `[..., N, 3]`."""

from .analytic import constant, directional, disc, hemisphere, sphere
from .built_in import BUILT_IN, built_in
from .capture import capture
from .coefficients import read_coefficients, write_coefficients
from .damage import DamagedImageWarning, ImageReport, inspect
from .dominant import dominant
from .emitters import Emitter, MeshEmitter, RectangleEmitter, SphereEmitter, incident, local_light
from .environment import cube_to_latlong, latlong_to_cube, project
from .exr import write_exr
from .image import read, read_with_report
from .probes import blend_weights, sample_points, with_sample_points
from .sky import clear_sky, clear_sky_radiance, overcast_sky
from .studio import studio
from .sun import sun_radiance
from .windowed import WINDOWS, window_factors, windowed

__all__ = [
    "BUILT_IN",
    "WINDOWS",
    "DamagedImageWarning",
    "Emitter",
    "ImageReport",
    "MeshEmitter",
    "RectangleEmitter",
    "SphereEmitter",
    "blend_weights",
    "built_in",
    "capture",
    "clear_sky",
    "clear_sky_radiance",
    "constant",
    "cube_to_latlong",
    "directional",
    "disc",
    "dominant",
    "hemisphere",
    "incident",
    "inspect",
    "latlong_to_cube",
    "local_light",
    "overcast_sky",
    "project",
    "read",
    "read_coefficients",
    "read_with_report",
    "sample_points",
    "sphere",
    "studio",
    "sun_radiance",
    "window_factors",
    "windowed",
    "with_sample_points",
    "write_coefficients",
    "write_exr",
]
