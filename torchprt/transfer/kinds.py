"""The kinds of transfer by name."""

from __future__ import annotations

from typing import TypeAlias

from torchprt.transfer.diffuse import DiffuseTransfer
from torchprt.transfer.glossy import FactoredTransfer, GlossyTransfer, IncidentTransfer, VisibilityTransfer

Transfer: TypeAlias = DiffuseTransfer | GlossyTransfer | FactoredTransfer | IncidentTransfer | VisibilityTransfer

KINDS: dict[str, type[Transfer]] = {
    kind.kind: kind
    for kind in (DiffuseTransfer, GlossyTransfer, FactoredTransfer, IncidentTransfer, VisibilityTransfer)
}
