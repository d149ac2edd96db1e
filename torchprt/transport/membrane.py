"""Thin membranes: light on one side of a sheet shows through on the other."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.scene import Geometry
from torchprt.transfer.pieces import rows
from torchprt.transport.tables import Tables


@dataclass
class Sheets:
    """`partner [V]`: the receiver on the other side (any where there is none), `share [V]`: how much comes through."""

    partner: Int[Tensor, "V"]
    share: Float[Tensor, "V"]

    def through(self, arriving: Float[Tensor, "V W"], tables: Tables) -> Float[Tensor, "V W"]:
        """What arrives at a receiver plus its share of what arrives behind it.

        Source: Sloan, Luna and Snyder 2005, section 4 (the thin-membrane model): the sum of two clamped cosines.
        """
        found = tables.empty(*arriving.shape)
        share = self.share[:, None].to(arriving.dtype)
        for some in rows(*arriving.shape):
            torch.addcmul(arriving[some], share[some], arriving[self.partner[some]], out=found[some])
        return found


def sheets(geometry: Geometry) -> Sheets | None:
    """The membranes of a scene, or None if it has none."""
    has = (geometry.partner >= 0) & (geometry.translucency > 0)
    if not bool(has.any()):
        return None
    return Sheets(geometry.partner.clamp(min=0), torch.where(has, geometry.translucency, 0))
