"""What a bake leaves: receivers, layers and signals, and one file format."""

from .atlas import Atlas, bilinear
from .atlas_mips import mips
from .cells import Cells
from .clustered import Clustered
from .d3dx import load_d3dx
from .dense import Dense
from .file import FORMAT, load, save
from .grid import Grid, grid_in
from .layer import Diffuse, Layer
from .layers import Exit, Factored, Incident, Visibility
from .layout import Layout
from .neighbourhood import Neighbourhood
from .phase import Phase
from .receivers import Receivers, Sight, Texels, Vertices
from .resample import places, to_texels, to_vertices, with_channels
from .signal import Signal
from .transfer import Transfer, diffuse_transfer
from .zonal import Zonal

__all__ = [
    "FORMAT",
    "Atlas",
    "Cells",
    "Clustered",
    "Dense",
    "Diffuse",
    "Exit",
    "Factored",
    "Grid",
    "Incident",
    "Layer",
    "Layout",
    "Neighbourhood",
    "Phase",
    "Receivers",
    "Sight",
    "Signal",
    "Texels",
    "Transfer",
    "Vertices",
    "Visibility",
    "Zonal",
    "bilinear",
    "diffuse_transfer",
    "grid_in",
    "load",
    "load_d3dx",
    "mips",
    "places",
    "save",
    "to_texels",
    "to_vertices",
    "with_channels",
]
