"""What a bake leaves: receivers, layers and signals, and one file format."""

from .clustered import Clustered
from .d3dx import load_d3dx
from .dense import Dense
from .file import FORMAT, load, save
from .layer import Diffuse, Layer
from .layers import Exit, Factored, Incident, Visibility
from .layout import Layout
from .receivers import Receivers, Sight, Texels, Vertices
from .signal import Signal
from .transfer import Transfer, diffuse_transfer
from .zonal import Zonal

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
    "Sight",
    "Signal",
    "Texels",
    "Transfer",
    "Vertices",
    "Visibility",
    "Zonal",
    "diffuse_transfer",
    "load",
    "load_d3dx",
    "save",
]
