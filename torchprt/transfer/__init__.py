"""What a bake leaves: the kinds of transfer and one file format."""

from .clustered import ClusteredFactoredTransfer as ClusteredFactoredTransfer
from .clustered import ClusteredGlossyTransfer as ClusteredGlossyTransfer
from .clustered import ClusteredIncidentTransfer as ClusteredIncidentTransfer
from .clustered import ClusteredTransfer as ClusteredTransfer
from .clustered import ClusteredVisibilityTransfer as ClusteredVisibilityTransfer
from .diffuse import DiffuseTransfer as DiffuseTransfer
from .file import FORMAT as FORMAT
from .file import load as load
from .file import save as save
from .glossy import FactoredTransfer as FactoredTransfer
from .glossy import GlossyTransfer as GlossyTransfer
from .glossy import IncidentTransfer as IncidentTransfer
from .glossy import VisibilityTransfer as VisibilityTransfer
from .kinds import BakedTransfer as BakedTransfer
from .kinds import CompressedTransfer as CompressedTransfer
from .kinds import Transfer as Transfer
from .zonal import ZonalTransfer as ZonalTransfer
from .zonal_factored import ZonalFactoredTransfer as ZonalFactoredTransfer
from .zonal_map import ZonalMap as ZonalMap
from .zonal_map import holds_map as holds_map
from .zonal_map import load_map as load_map
from .zonal_map import save_map as save_map
from .zonal_map import zonal_map as zonal_map

__all__ = [
    "FORMAT",
    "BakedTransfer",
    "ClusteredFactoredTransfer",
    "ClusteredGlossyTransfer",
    "ClusteredIncidentTransfer",
    "ClusteredTransfer",
    "ClusteredVisibilityTransfer",
    "CompressedTransfer",
    "DiffuseTransfer",
    "FactoredTransfer",
    "GlossyTransfer",
    "IncidentTransfer",
    "Transfer",
    "VisibilityTransfer",
    "ZonalFactoredTransfer",
    "ZonalMap",
    "ZonalTransfer",
    "holds_map",
    "load",
    "load_map",
    "save",
    "save_map",
    "zonal_map",
]
