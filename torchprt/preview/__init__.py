"""Pictures of what was baked: stills without a display, models with vertex colours."""

from typing import TYPE_CHECKING

from torchprt.lazily import lazily

from .error_colours import error_colours as error_colours
from .lobe import Lobe as Lobe
from .lobe import lobe as lobe
from .sheet import sheet as sheet

if TYPE_CHECKING:
    from .asset_file import AssetWarning as AssetWarning
    from .asset_light import keep_light as keep_light
    from .asset_light import save_lit_glb as save_lit_glb
    from .asset_map import save_mapped_glb as save_mapped_glb
    from .asset_source import Asset as Asset
    from .asset_source import find_asset as find_asset
    from .attributes import save_transfer_glb as save_transfer_glb
    from .camera import Camera as Camera
    from .camera import frame as frame
    from .cast import Cast as Cast
    from .cast import along as along
    from .cast import motions as motions
    from .environment import Environment as Environment
    from .environment import automatic_exposure as automatic_exposure
    from .environment import built_in_environment as built_in_environment
    from .environment import photograph as photograph
    from .environment import seen_along as seen_along
    from .glb import save_glb as save_glb
    from .ground import subject as subject
    from .lightmap import irradiance_exposure as irradiance_exposure
    from .lightmap import save_map as save_map
    from .looking import Picture as Picture
    from .looking import look as look
    from .looking import look_at_light as look_at_light
    from .model import colours as colours
    from .model import linear_colours as linear_colours
    from .model import save_ply as save_ply
    from .model import tone_map as tone_map
    from .orbit import Orbit as Orbit
    from .per_pixel import PatchStudio as PatchStudio
    from .picture import Still as Still
    from .picture import save_png as save_png
    from .relight import Relight as Relight
    from .saving import save_movie as save_movie
    from .saving import save_picture as save_picture
    from .session import Session as Session
    from .sight import sight_colours as sight_colours
    from .sight import sight_legend as sight_legend
    from .turntable import Background as Background
    from .turntable import Studio as Studio
    from .turntable import save_gif as save_gif
    from .turntable import strip as strip
    from .video import check_video as check_video
    from .video import save_mp4 as save_mp4
    from .volume import VolumeStudio as VolumeStudio
    from .volume import studio_of as studio_of
    from .volume_session import VolumeSession as VolumeSession
    from .volume_session import session_of as session_of
    from .window import check_window as check_window
    from .window import show as show

_NAMES = {
    "Asset": "asset_source",
    "AssetWarning": "asset_file",
    "Background": "turntable",
    "Camera": "camera",
    "Cast": "cast",
    "Environment": "environment",
    "Orbit": "orbit",
    "PatchStudio": "per_pixel",
    "Picture": "looking",
    "Relight": "relight",
    "Session": "session",
    "Still": "picture",
    "Studio": "turntable",
    "VolumeSession": "volume_session",
    "VolumeStudio": "volume",
    "along": "cast",
    "automatic_exposure": "environment",
    "built_in_environment": "environment",
    "check_video": "video",
    "check_window": "window",
    "colours": "model",
    "find_asset": "asset_source",
    "frame": "camera",
    "irradiance_exposure": "lightmap",
    "keep_light": "asset_light",
    "linear_colours": "model",
    "look": "looking",
    "look_at_light": "looking",
    "motions": "cast",
    "photograph": "environment",
    "save_gif": "turntable",
    "save_glb": "glb",
    "save_lit_glb": "asset_light",
    "save_map": "lightmap",
    "save_mapped_glb": "asset_map",
    "save_movie": "saving",
    "save_mp4": "video",
    "save_picture": "saving",
    "save_ply": "model",
    "save_png": "picture",
    "save_transfer_glb": "attributes",
    "seen_along": "environment",
    "session_of": "volume_session",
    "show": "window",
    "sight_colours": "sight",
    "sight_legend": "sight",
    "strip": "turntable",
    "studio_of": "volume",
    "subject": "ground",
    "tone_map": "model",
}
__all__ = ["error_colours", "Lobe", "lobe", "sheet", *_NAMES]
__getattr__, __dir__ = lazily(__name__, _NAMES)
