"""What the materials of a file say between the vertices of its mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from jaxtyping import Float32
from torch import Tensor

from .glosses import Glosses

if TYPE_CHECKING:
    from .surface import Surface


@dataclass(frozen=True, eq=False)
class Detail:
    """Where a material comes from: the `surface` of a file, and which values of its vertices were made of that.

    A material keeps it beside these values. What was replaced since is no longer of the file: `Finish` asks whether a
    value is the same tensor. Whether a gloss was taken: `glosses`; None for a diffuse one.
    """

    surface: Surface
    albedo: Float32[Tensor, "V 3"] | None = None
    specular: Float32[Tensor, "V 3"] | None = None
    glosses: Glosses | None = None
    gloss: bool = False
    """Whether the gloss of the file was asked for: metal is then no albedo."""
