"""Where a bake could not look out as it stood: the vertices whose transfer was turned, moved or filled, in colours."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.preview.lobe import TOWARD

# By the numbers of `Vertices.sight`: what was done, the name of the colour, its sRGB.
SIGHTS = (
    ("looked out as it stands", "grey", (0.72, 0.72, 0.70)),
    ("looked out along another normal", "blue", (0.16, 0.45, 0.95)),
    ("looked out from another place", "green", (0.13, 0.70, 0.30)),
    ("was filled from its neighbours", "orange", (0.98, 0.60, 0.10)),
    ("is blind, and dark", "red", (0.90, 0.12, 0.16)),
)


def sight_of(receivers: Any) -> Tensor | None:
    """The numbers `[V]` of what each vertex is, int64; None where a bake does not say."""
    sight = getattr(receivers, "sight", None)
    return None if sight is None else sight.long()


def sight_colours(receivers: Any) -> Float[Tensor, "V 3"]:
    """sRGB of the vertices by what they are, with a little shade so that the shape is seen.

    Raises InputError if there is no `sight`.
    """
    sight = sight_of(receivers)
    if sight is None:
        raise InputError("this bake does not say which of its vertices could look out: bake it again")
    colour = torch.tensor([each[2] for each in SIGHTS])[sight]
    toward = torch.nn.functional.normalize(torch.tensor(TOWARD), dim=0)
    return colour * (0.8 + 0.2 * receivers.normals.float() @ toward)[:, None]


def sight_legend(receivers: Any) -> list[str]:
    """A line for each colour that there is: which it is, how many vertices, and what it says of them."""
    sight = sight_of(receivers)
    if sight is None:
        return []
    counts = torch.bincount(sight, minlength=len(SIGHTS)).tolist()
    return [
        f"{colour}: {count} {'vertex' if count == 1 else 'vertices'}, each {what}"
        for (what, colour, _), count in zip(SIGHTS, counts, strict=True)
        if count
    ]
