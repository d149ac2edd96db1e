"""Which vertices could not look out as they stood when they were baked, in colours."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.preview.lobe import TOWARD
from torchprt.transfer import Receivers
from torchprt.transfer.receivers import Sight
from torchprt.words import count

# What each came to its transfer by, the name of its colour, sRGB.
COLOURS = {
    Sight.VALID: ("by its own rays", "grey", (0.72, 0.72, 0.70)),
    Sight.TURNED: ("by its own rays about another normal", "blue", (0.16, 0.45, 0.95)),
    Sight.MOVED: ("by its own rays from another place", "green", (0.13, 0.70, 0.30)),
    Sight.FILLED: ("from its neighbours", "orange", (0.98, 0.60, 0.10)),
    Sight.BLIND: ("not at all, and dark", "red", (0.90, 0.12, 0.16)),
}


def sight_colours(receivers: Receivers) -> Float[Tensor, "V 3"]:
    """sRGB of the receivers by how they came to their transfer (`Sight`), a little shaded to show the shape."""
    colour = torch.tensor([COLOURS[kind][2] for kind in Sight])[_sight(receivers)]
    toward = torch.nn.functional.normalize(torch.tensor(TOWARD), dim=0)
    return colour * (0.8 + 0.2 * receivers.normals.float() @ toward)[:, None]


def sight_legend(receivers: Receivers) -> list[str]:
    """A line for each colour that there is: which it is, how many have it, and how they came to their transfer."""
    place = "vertex" if receivers.surface_uv is None else "texel"
    if getattr(receivers, "sight", None) is None:
        return [f"grey: no {place} is marked, all saw by their own rays or nobody looked"]
    counts = torch.bincount(_sight(receivers), minlength=len(Sight)).tolist()
    return [
        f"{COLOURS[kind][1]}: {count(number, place)}, lit {COLOURS[kind][0]}"
        for kind, number in zip(Sight, counts, strict=True)
        if number
    ]


def _sight(receivers: Receivers) -> Tensor:
    """A number of `Sight` for each, int64."""
    sight = getattr(receivers, "sight", None)
    return torch.zeros(receivers.count, dtype=torch.long) if sight is None else sight.long()
