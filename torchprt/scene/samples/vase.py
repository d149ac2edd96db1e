"""A vase: a smooth surface with texture coordinates, to lay patches on and to bend."""

from torchprt.errors import InputError

from ..material import Albedo, Material
from ..mesh import make_mesh
from ..object import Object
from ..scene import Scene
from .lathe import lathe, smooth_profile

PROFILE = [
    (0.0, 0.0),
    (0.42, 0.0),
    (0.5, 0.03),
    (0.46, 0.14),
    (0.72, 0.7),
    (0.66, 1.4),
    (0.3, 1.72),
    (0.28, 1.95),
    (0.46, 2.2),
    (0.4, 2.22),
    (0.2, 1.95),
    (0.22, 1.7),
    (0.5, 1.4),
    (0.5, 0.6),
    (0.3, 0.2),
    (0.0, 0.2),
]
"""Radius and height of points whose curve is turned about +y: foot, belly, neck, lip, inside."""


def vase(resolution: int = 128, albedo: Albedo = 0.6) -> Scene:
    """A round, hollow vase, 1.3 units wide and 2.2 high, standing on y = 0.

    Turned from 2 `resolution` columns around and `resolution` rows along its profile, closed, with texture
    coordinates: u around, from 0 to 1 (a whole number of patches meets itself there), v along the profile from the
    middle of the foot over the lip to the middle of the inside. The outside ends at v = .54.

    Raises InputError if `resolution` is below 16.
    """
    if resolution < 16:
        raise InputError(f"resolution is {resolution}: give at least 16")
    positions, faces, uv = lathe(smooth_profile(PROFILE, resolution), 2 * resolution)
    return Scene([Object(make_mesh(positions, faces, name="vase", uv=uv), Material(albedo))])
