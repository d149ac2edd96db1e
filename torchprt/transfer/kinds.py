"""The kinds of transfer by name."""

from __future__ import annotations

from typing import TypeAlias

from torchprt.transfer.clustered import (
    ClusteredFactoredTransfer,
    ClusteredGlossyTransfer,
    ClusteredIncidentTransfer,
    ClusteredTransfer,
    ClusteredVisibilityTransfer,
)
from torchprt.transfer.diffuse import DiffuseTransfer
from torchprt.transfer.glossy import FactoredTransfer, GlossyTransfer, IncidentTransfer, VisibilityTransfer
from torchprt.transfer.zonal import ZonalTransfer
from torchprt.transfer.zonal_factored import ZonalFactoredTransfer

BakedTransfer: TypeAlias = DiffuseTransfer | GlossyTransfer | FactoredTransfer | IncidentTransfer | VisibilityTransfer
CompressedTransfer: TypeAlias = (
    ClusteredTransfer
    | ClusteredGlossyTransfer
    | ClusteredFactoredTransfer
    | ClusteredIncidentTransfer
    | ClusteredVisibilityTransfer
)
Transfer: TypeAlias = BakedTransfer | CompressedTransfer | ZonalTransfer | ZonalFactoredTransfer

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
        ClusteredFactoredTransfer,
        ClusteredIncidentTransfer,
        ClusteredVisibilityTransfer,
        ZonalTransfer,
        ZonalFactoredTransfer,
    )
}

# What looks the same from everywhere.
DIFFUSE = (DiffuseTransfer, ClusteredTransfer, ZonalTransfer)

# What leaves the reflectance to be chosen at run time.
INCIDENT = (IncidentTransfer, ClusteredIncidentTransfer)
