"""A closed mesh of a wanted number of vertices around a solid."""

import numpy as np
from jaxtyping import Float

from ..mesh import Mesh, make_mesh
from .surface_nets import Field, surface_nets


def closed_mesh(
    field: Field, low: Float[np.ndarray, "3"], high: Float[np.ndarray, "3"], vertices: int, name: str
) -> Mesh:
    """One closed piece of surface with `vertices` vertices within 2 %, where `field` is zero within the box."""
    # The number of vertices goes with the square of the resolution.
    cell = 0.06
    for attempt in range(16):
        positions, faces = surface_nets(field, low, high, cell, relaxations=3 if attempt else 0)
        close = attempt > 0 and abs(len(positions) - vertices) <= 0.02 * vertices
        if close:
            mesh = make_mesh(positions, faces, name=name)
            if mesh.report.watertight and mesh.report.components == 1:
                return mesh
        # A thin end that fell between the cells comes back on a slightly different grid.
        # Shorter steps later: where a flat face slips between cells the number jumps, and whole steps would overshoot.
        cell *= 0.997 if close else (len(positions) / vertices) ** (0.5 if attempt < 3 else 0.2)
    raise RuntimeError(f"no closed surface of {vertices} vertices was found")
