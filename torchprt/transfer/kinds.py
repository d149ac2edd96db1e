"""The kinds of transfer by name."""

from __future__ import annotations

from typing import TypeAlias

from torchprt.transfer.clustered import ClusteredGlossyTransfer, ClusteredTransfer
from torchprt.transfer.diffuse import DiffuseTransfer
from torchprt.transfer.glossy import FactoredTransfer, GlossyTransfer, IncidentTransfer, VisibilityTransfer
from torchprt.transfer.zonal import ZonalTransfer
from torchprt.transfer.zonal_factored import ZonalFactoredTransfer

BakedTransfer: TypeAlias = DiffuseTransfer | GlossyTransfer | FactoredTransfer | IncidentTransfer | VisibilityTransfer
Transfer: TypeAlias = (
    BakedTransfer | ClusteredTransfer | ClusteredGlossyTransfer | ZonalTransfer | ZonalFactoredTransfer
)

KINDS: dict[str, type[Transfer]] = {
    kind.kind: kind
    for kind in (
        DiffuseTransfer,
        GlossyTransfer,
        FactoredTransfer,
        IncidentTransfer,
        VisibilityTransfer,
        ClusteredTransfer,
        ClusteredGlossyTransfer,
        ZonalTransfer,
        ZonalFactoredTransfer,
    )
}

# What looks the same from everywhere.
DIFFUSE = (DiffuseTransfer, ClusteredTransfer, ZonalTransfer)
