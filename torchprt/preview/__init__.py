"""Pictures of what was baked: stills without a display, models with vertex colours."""

from .attributes import save_transfer_glb as save_transfer_glb
from .camera import Camera as Camera
from .camera import frame as frame
from .error_colours import error_colours as error_colours
from .glb import save_glb as save_glb
from .model import colours as colours
from .model import linear_colours as linear_colours
from .model import save_ply as save_ply
from .model import tone_map as tone_map
from .picture import Still as Still
from .picture import save_png as save_png
from .sheet import sheet as sheet

__all__ = [
    "Camera",
    "Still",
    "colours",
    "error_colours",
    "frame",
    "linear_colours",
    "save_glb",
    "save_ply",
    "save_png",
    "save_transfer_glb",
    "sheet",
    "tone_map",
]
