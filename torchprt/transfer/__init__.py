"""What a bake leaves: the kinds of transfer and one file format."""

from .clustered import ClusteredGlossyTransfer as ClusteredGlossyTransfer
from .clustered import ClusteredTransfer as ClusteredTransfer
from .diffuse import DiffuseTransfer as DiffuseTransfer
from .file import FORMAT as FORMAT
from .file import load as load
from .file import save as save
from .glossy import FactoredTransfer as FactoredTransfer
from .glossy import GlossyTransfer as GlossyTransfer
from .glossy import IncidentTransfer as IncidentTransfer
from .glossy import VisibilityTransfer as VisibilityTransfer
from .kinds import BakedTransfer as BakedTransfer
from .kinds import Transfer as Transfer

__all__ = [
    "FORMAT",
    "BakedTransfer",
    "ClusteredGlossyTransfer",
    "ClusteredTransfer",
    "DiffuseTransfer",
    "FactoredTransfer",
    "GlossyTransfer",
    "IncidentTransfer",
    "Transfer",
    "VisibilityTransfer",
    "load",
    "save",
]
