"""Several glosses on one surface, and few of them for many."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from torch import Tensor

from torchprt.brdf import GGX, Brdf
from torchprt.errors import InputError

SMOOTHEST = 0.01
"""The least width of GGX."""


@dataclass(frozen=True, eq=False)
class Glosses:
    """Different glosses on one surface: `models`, and which of them lies on each vertex, -1 for none.

    Raises InputError if a number names no model.
    """

    models: tuple[Brdf, ...]
    of_vertex: Int64[Tensor, "V"]

    def __post_init__(self) -> None:
        if not self.models:
            raise InputError("gloss has no models: give at least one, or no gloss")
        if bool(((self.of_vertex < -1) | (self.of_vertex >= len(self.models))).any()):
            raise InputError(f"gloss names a model outside of 0 to {len(self.models) - 1}: -1 is for none")

    @property
    def spec(self) -> str:
        """The models in words."""
        return ", ".join(brdf.spec for brdf in self.models)


def few_glosses(
    roughness: Float[np.ndarray, "V"], reflectance: Float[np.ndarray, "V"], most: int = 12
) -> tuple[Glosses | None, float]:
    """At most `most` GGX that stand for those of every vertex, and the largest change of roughness.

    `roughness` is that of glTF, whose square is the width; `reflectance` is the largest of the three along the normal,
    and a vertex where it is zero has no gloss. The vertices are cut in two where they differ most, again and again;
    a part has the middle of its roughnesses and the largest of its reflectances. None if no vertex has a gloss.
    """
    values = np.stack([np.clip(roughness, 0, 1), np.sqrt(np.clip(reflectance, 0, 1))], axis=1)
    label = np.full(len(values), -1)
    shiny = np.flatnonzero(values[:, 1] > 1e-3)
    if not len(shiny):
        return None, 0.0
    parts = [shiny]
    while len(parts) < most:
        spreads = [np.ptp(values[part], axis=0) for part in parts]
        widest = max(range(len(parts)), key=lambda number: float(spreads[number].max()))
        if spreads[widest].max() < 1e-4:
            break
        part = parts.pop(widest)
        axis = int(spreads[widest].argmax())
        middle = (values[part, axis].min() + values[part, axis].max()) / 2
        low = values[part, axis] <= middle
        parts += [part[low], part[~low]]
    models, change = [], 0.0
    for number, part in enumerate(parts):
        label[part] = number
        least, largest = values[part, 0].min(), values[part, 0].max()
        change = max(change, float(largest - least) / 2)
        width = max(((least + largest) / 2) ** 2, SMOOTHEST)
        models.append(GGX(float(np.round(width, 6)), float(np.round(min(values[part, 1].max() ** 2, 1.0), 6))))
    return Glosses(tuple(models), torch.from_numpy(label.astype(np.int64))), change
