"""A turned metal dish: brushed around, so that its highlights are streaks."""

from torchprt.errors import InputError

from ..material import Material
from ..material_file import read_material
from ..mesh import make_mesh
from ..object import Object
from ..scene import Scene
from .lathe import lathe, smooth_profile

PROFILE = [
    (0.0, 0.0),
    (0.7, 0.0),
    (0.86, 0.0),
    (1.02, 0.2),
    (1.3, 0.31),
    (1.36, 0.335),
    (1.35, 0.385),
    (1.26, 0.365),
    (1.0, 0.26),
    (0.8, 0.075),
    (0.45, 0.06),
    (0.17, 0.06),
    (0.07, 0.075),
    (0.07, 0.2),
    (0.19, 0.24),
    (0.19, 0.4),
    (0.08, 0.42),
    (0.0, 0.42),
]
"""Radius and height of points whose curve is turned about +y: underside, rim, inside, knob."""


def dish(resolution: int = 128, material: Material | str = "ward:0.1,0.4") -> Scene:
    """A round dish, 2.7 units wide on y = 0, with a knob in its middle that casts shadow and is reflected.

    Turned from 2 `resolution` columns around and `resolution` rows along its profile (32514 vertices by default),
    closed, with texture coordinates: u around (counter-clockwise seen from above), v along the profile from the
    middle of the underside to the top of the knob. The two poles have no direction around and take that of their
    neighbourhood. `material` is one, or text as `read_material` takes.

    Raises InputError if `resolution` is below 16, and as `read_material` does.
    """
    if resolution < 16:
        raise InputError(f"resolution is {resolution}: give at least 16")
    material = read_material(material) if isinstance(material, str) else material
    positions, faces, uv = lathe(smooth_profile(PROFILE, resolution), 2 * resolution)
    return Scene([Object(make_mesh(positions, faces, name="dish", uv=uv), material)])
