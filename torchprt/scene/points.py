"""Receivers that are not vertices of the scene: splats, billboards, levels of detail."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError

from .material import Albedo, check_albedo, rows, table
from .normals import unit


@dataclass(frozen=True, eq=False)
class Points:
    """Points with normals that record light in a scene and block none of it.

    positions: [V, 3], in the frame and unit of the scene; kept as float64.
    normals: [V, 3] of any length; kept as float64 unit vectors. A zero normal receives no light.
    albedo: one number, three, or a tensor [V, 1] or [V, 3], in [0, 1]; kept as float32 [V, 1] or [V, 3].

    Raises InputError if there are no points, if anything is not finite, or if an albedo is outside [0, 1].
    """

    positions: Float[Tensor, "V 3"]
    normals: Float[Tensor, "V 3"]
    albedo: Albedo = 0.5

    def __post_init__(self) -> None:
        positions = self.positions.detach().to("cpu", torch.float64)
        normals = self.normals.detach().to("cpu", torch.float64)
        if not len(positions):
            raise InputError("points are none: give at least one position and normal")
        if isinstance(self.albedo, str):
            raise InputError(f"points have no vertex colours for albedo {self.albedo!r}: give the albedo as numbers")
        for name, values in (("positions", positions), ("normals", normals)):
            bad = ~values.isfinite().all(dim=1)
            if bad.any():
                raise InputError(
                    f"{name} of the points are not finite in {int(bad.sum())} rows, the first is row "
                    f"{int(bad.nonzero()[0])}: remove them"
                )
        albedo = table(self.albedo)
        check_albedo(albedo, "albedo")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "normals", torch.from_numpy(unit(normals.numpy())))
        object.__setattr__(self, "albedo", rows(albedo, len(positions), "the points"))
