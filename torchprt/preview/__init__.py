"""Pictures of what was baked: stills without a display, models with vertex colours."""

from .camera import Camera as Camera
from .camera import frame as frame
from .model import colours as colours
from .model import save_ply as save_ply
from .model import tone_map as tone_map
from .picture import Still as Still
from .picture import save_png as save_png
from .sheet import sheet as sheet

__all__ = ["Camera", "Still", "colours", "frame", "save_ply", "save_png", "sheet", "tone_map"]
