"""Pictures of what was baked: stills without a display, models with vertex colours."""

from .asset_file import AssetWarning
from .asset_light import keep_light, save_lit_glb
from .asset_map import save_mapped_glb
from .asset_source import Asset, find_asset
from .attributes import save_transfer_glb
from .camera import Camera, frame
from .cast import Cast, along, motions
from .environment import Environment, automatic_exposure, built_in_environment, photograph, seen_along
from .error_colours import error_colours
from .glb import save_glb
from .ground import subject
from .lightmap import irradiance_exposure, save_map
from .lobe import Lobe, lobe
from .look import Picture, look, look_at_light
from .model import colours, linear_colours, save_ply, tone_map
from .orbit import Orbit
from .per_pixel import PatchStudio
from .picture import Still, save_png
from .relight import Relight
from .saving import save_movie, save_picture
from .session import Session
from .sheet import sheet
from .sight import sight_colours, sight_legend
from .turntable import Background, Studio, save_gif, strip
from .video import check_video, save_mp4
from .volume import VolumeStudio, studio_of
from .volume_session import VolumeSession, session_of
from .window import check_window, show

__all__ = [
    "Asset",
    "AssetWarning",
    "Background",
    "Camera",
    "Cast",
    "Environment",
    "Lobe",
    "Orbit",
    "PatchStudio",
    "Picture",
    "Relight",
    "Session",
    "Still",
    "Studio",
    "VolumeSession",
    "VolumeStudio",
    "along",
    "automatic_exposure",
    "built_in_environment",
    "check_video",
    "check_window",
    "colours",
    "error_colours",
    "find_asset",
    "frame",
    "irradiance_exposure",
    "keep_light",
    "linear_colours",
    "lobe",
    "look",
    "look_at_light",
    "motions",
    "photograph",
    "save_gif",
    "save_glb",
    "save_lit_glb",
    "save_map",
    "save_mapped_glb",
    "save_movie",
    "save_mp4",
    "save_picture",
    "save_ply",
    "save_png",
    "save_transfer_glb",
    "seen_along",
    "session_of",
    "sheet",
    "show",
    "sight_colours",
    "sight_legend",
    "strip",
    "studio_of",
    "subject",
    "tone_map",
]
