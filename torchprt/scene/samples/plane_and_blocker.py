"""A ground plane under a single polygon: the plainest soft shadow there is."""

from torchprt.errors import InputError

from ..material import Albedo, Material
from ..mesh import make_mesh
from ..object import Object
from ..scene import Scene
from .grid import grid


def plane_and_blocker(resolution: int = 128, albedo: Albedo = 0.5) -> Scene:
    """A square plane of `resolution` by `resolution` squares, 4 wide at y = 0, and a black square, 1 wide, above it.

    The blocker lies .5 above the middle of the plane. Every point of the plane sees it as one polygon, so its
    transfer can be computed by other means and compared.

    Raises InputError if `resolution` is below 1.
    Source: Sloan, Kautz and Snyder 2002, figure 10.
    """
    if resolution < 1:
        raise InputError(f"resolution is {resolution}: give at least 1")
    plane = grid((-2.0, 0.0, 2.0), (4.0, 0.0, 0.0), (0.0, 0.0, -4.0), resolution, resolution)
    blocker = grid((-0.5, 0.5, 0.5), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), 1, 1)
    return Scene(
        [
            Object(make_mesh(*plane, name="plane"), Material(albedo)),
            Object(make_mesh(*blocker, name="blocker"), Material(0.0), "blocker"),
        ]
    )
