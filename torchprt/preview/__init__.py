"""Pictures of what was baked: stills without a display, models with vertex colours."""

from .attributes import save_transfer_glb as save_transfer_glb
from .camera import Camera as Camera
from .camera import frame as frame
from .environment import Environment as Environment
from .environment import automatic_exposure as automatic_exposure
from .environment import photograph as photograph
from .environment import seen_along as seen_along
from .error_colours import error_colours as error_colours
from .glb import save_glb as save_glb
from .lobe import Lobe as Lobe
from .lobe import lobe as lobe
from .model import colours as colours
from .model import linear_colours as linear_colours
from .model import save_ply as save_ply
from .model import tone_map as tone_map
from .orbit import Orbit as Orbit
from .picture import Still as Still
from .picture import save_png as save_png
from .relight import Relight as Relight
from .session import Session as Session
from .sheet import sheet as sheet
from .turntable import Studio as Studio
from .turntable import save_gif as save_gif
from .turntable import strip as strip
from .window import check_window as check_window
from .window import show as show

__all__ = [
    "Camera",
    "Environment",
    "Lobe",
    "Orbit",
    "Relight",
    "Session",
    "Still",
    "Studio",
    "automatic_exposure",
    "check_window",
    "colours",
    "error_colours",
    "frame",
    "linear_colours",
    "lobe",
    "photograph",
    "save_gif",
    "save_glb",
    "save_ply",
    "save_png",
    "save_transfer_glb",
    "seen_along",
    "sheet",
    "show",
    "strip",
    "tone_map",
]
