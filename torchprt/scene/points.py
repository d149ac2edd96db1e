"""Receivers that are not vertices of the scene: splats, billboards, levels of detail."""

from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from torchprt.brdf import Brdf
from torchprt.errors import InputError

from .glosses import Glosses
from .material import Albedo, Material, check_albedo, rows, table
from .normals import unit
from .tangents import orthogonal


@dataclass(frozen=True, eq=False)
class Points:
    """Points with normals that record light in a scene and block none of it.

    positions: [V, 3], in the frame and unit of the scene; kept as float64.
    normals: [V, 3] of any length; kept as float64 unit vectors. A zero normal receives no light.
    albedo: one number, three, or a tensor [V, 1] or [V, 3], in [0, 1]; kept as float32 [V, 1] or [V, 3]. If it is not
    given it is .5, and 0 under a gloss.
    gloss: a BRDF that is added to the diffuse part, its text ("ggx:0.3,0.04"), or `Glosses` for different ones at
    different points; kept as `Glosses`, None without.
    specular: its weight, given and kept as the albedo is.
    tangents: [V, 3], which the local frames of glossy points follow; kept as float64 unit vectors, orthogonal to the
    normals, zero where a row says no direction: such points get a frame of their normal alone (`transport.frames`).

    Warns (`EnergyWarning`) as `Material` does. Raises InputError if there are no points, if anything is not finite, if
    a weight is outside [0, 1] or of another number of points, if the gloss is not known or creates energy, if there is
    a specular without it, or if it is anisotropic where no tangent says which way its streaks run.
    """

    positions: Float[Tensor, "V 3"]
    normals: Float[Tensor, "V 3"]
    albedo: Albedo | None = None
    gloss: Brdf | Glosses | str | None = None
    specular: Albedo = 1.0
    tangents: Float[Tensor, "V 3"] | None = None

    def __post_init__(self) -> None:
        positions, normals = _exact(self.positions), _exact(self.normals)
        tangents = torch.zeros_like(normals) if self.tangents is None else _exact(self.tangents)
        count = len(positions)
        if not count:
            raise InputError("points are none: give at least one position and normal")
        if isinstance(self.albedo, str):
            raise InputError(f"points have no vertex colours for albedo {self.albedo!r}: give the albedo as numbers")
        for name, values in (("positions", positions), ("normals", normals), ("tangents", tangents)):
            if values.shape != (count, 3):
                raise InputError(f"{name} of {count} points have shape {list(values.shape)}: give three numbers each")
            bad = ~values.isfinite().all(dim=1)
            if bad.any():
                raise InputError(
                    f"{name} of the points are not finite in {int(bad.sum())} rows, the first is row "
                    f"{int(bad.nonzero()[0])}: remove them"
                )
        # What a surface may be made of, points may.
        material = Material(self.albedo, gloss=self.gloss, specular=self.specular)
        gloss = material.gloss
        if gloss is not None and not isinstance(gloss, Glosses):
            gloss = Glosses(material.glosses, torch.zeros(count, dtype=torch.int64))
        if gloss is not None and gloss.of_vertex.shape != (count,):
            raise InputError(f"gloss has shape {list(gloss.of_vertex.shape)} for {count} points: give one each")
        directions = unit(normals.numpy())
        kept: dict[str, Any] = {"positions": positions, "normals": torch.from_numpy(directions), "gloss": gloss}
        kept["tangents"] = torch.from_numpy(orthogonal(tangents.numpy(), directions))
        for name in ("albedo", "specular"):
            values = table(getattr(material, name), name)
            check_albedo(values, name)
            kept[name] = rows(values, count, "the points", name)
        for name, value in kept.items():
            object.__setattr__(self, name, value)
        self._check_streaks()

    def _check_streaks(self) -> None:
        """Raises InputError if the streaks of a point have no direction."""
        if not isinstance(self.gloss, Glosses) or self.tangents is None:
            return
        for number, brdf in enumerate(self.gloss.models):
            lost = (self.gloss.of_vertex == number) & (self.tangents == 0).all(-1) & (self.normals != 0).any(-1)
            if not brdf.isotropic and bool(lost.any()):
                raise InputError(
                    f"tangents of {int(lost.sum())} points under the anisotropic gloss {brdf.spec} are missing or "
                    "along the normal: say which way its streaks run"
                )


def _exact(values: Float[Tensor, "..."]) -> Float64[Tensor, "..."]:
    return values.detach().to("cpu", torch.float64)
