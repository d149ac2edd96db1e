"""What a bake leaves: receivers, layers and signals, and one file format."""

from .clustered import Clustered as Clustered
from .dense import Dense as Dense
from .file import FORMAT as FORMAT
from .file import load as load
from .file import save as save
from .layer import Diffuse as Diffuse
from .layer import Layer as Layer
from .layers import Exit as Exit
from .layers import Factored as Factored
from .layers import Incident as Incident
from .layers import Visibility as Visibility
from .layout import Layout as Layout
from .receivers import Receivers as Receivers
from .receivers import Texels as Texels
from .receivers import Vertices as Vertices
from .signal import Signal as Signal
from .transfer import Transfer as Transfer
from .transfer import diffuse_transfer as diffuse_transfer
from .zonal import Zonal as Zonal

__all__ = [
    "FORMAT",
    "Clustered",
    "Dense",
    "Diffuse",
    "Exit",
    "Factored",
    "Incident",
    "Layer",
    "Layout",
    "Receivers",
    "Signal",
    "Texels",
    "Transfer",
    "Vertices",
    "Visibility",
    "Zonal",
    "diffuse_transfer",
    "load",
    "save",
]
