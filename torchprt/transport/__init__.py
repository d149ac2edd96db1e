"""Embree bakes what light does on its way: each kind of transport, with progress, cancel and resume."""

from torchprt.checkpoint import CheckpointWarning as CheckpointWarning

from .bake import bake as bake
from .bake_glossy import OrderWarning as OrderWarning
from .diffuse import unshadowed as unshadowed
from .directions import frames as frames
from .directions import hemisphere as hemisphere
from .membrane_lobes import membrane_lobes as membrane_lobes
from .patch import bake_patch as bake_patch
from .patch import patch_transfer as patch_transfer
from .task import Runner as Runner
from .task import Task as Task
from .workers import Processes as Processes
from .workers import Threads as Threads
from .wrinkle import groove_transfer as groove_transfer
from .wrinkle import wrinkle as wrinkle

__all__ = [
    "CheckpointWarning",
    "OrderWarning",
    "Processes",
    "Runner",
    "Task",
    "Threads",
    "bake",
    "bake_patch",
    "frames",
    "groove_transfer",
    "hemisphere",
    "membrane_lobes",
    "patch_transfer",
    "unshadowed",
    "wrinkle",
]
