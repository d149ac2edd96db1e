"""Pictures of what was baked: stills without a display."""

from .camera import Camera as Camera
from .camera import frame as frame
from .picture import Still as Still
from .picture import save_png as save_png

__all__ = ["Camera", "Still", "frame", "save_png"]
