"""Embree bakes what light does on its way: each kind of transport, with progress, cancel and resume."""

from torchprt.checkpoint import CheckpointWarning as CheckpointWarning

from .bake import bake
from .bake_glossy import OrderWarning
from .capture import lamps_seen
from .cluster import Cluster
from .diffuse import unshadowed
from .directions import frames, hemisphere
from .membrane_lobes import membrane_lobes
from .mirrors import MirrorWarning
from .neighbourhood import GridWarning, bake_neighbourhood
from .output import Output
from .passes import VolumeWarning
from .patch import bake_patch, patch_transfer
from .task import Runner, Task
from .volume import bake_volume
from .workers import Processes, Threads
from .wrinkle import groove_transfer, wrinkle

__all__ = [
    "CheckpointWarning",
    "Cluster",
    "GridWarning",
    "MirrorWarning",
    "OrderWarning",
    "Output",
    "Processes",
    "Runner",
    "Task",
    "Threads",
    "VolumeWarning",
    "bake",
    "bake_neighbourhood",
    "bake_patch",
    "bake_volume",
    "frames",
    "groove_transfer",
    "hemisphere",
    "lamps_seen",
    "membrane_lobes",
    "patch_transfer",
    "unshadowed",
    "wrinkle",
]
