"""What a file is, by its suffix and by its first bytes, so that one taken for another is called by its name."""

from __future__ import annotations

import difflib
import os
import stat
from collections.abc import Sequence
from pathlib import Path

from torchprt.errors import InputError

MESHES = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off", ".usd", ".usda", ".usdc", ".usdz")
IMAGES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".gif")
VIDEOS = (".mp4",)
VOLUMES = (".npy", ".npz", ".vdb", ".nvdb")
# What one picture is written as, several one after the other, and what holds opacity.
PICTURES = (".png", ".jpg", ".jpeg", ".webp")
MOVIES = (".gif", ".webp", ".mp4")
TRANSPARENT = (".png", ".webp")
# What a file of a suffix is, and what to do with one that was given for something else.
_KINDS = {
    **dict.fromkeys(MESHES, ("a mesh", "bake it with `torchprt bake` or read it with prt.load")),
    **dict.fromkeys(IMAGES, ("an image", "give it as a light, or read it with prt.light.read")),
    **dict.fromkeys(VOLUMES, ("a volume", "bake it with `torchprt volume` or read it with prt.scene.read_volume")),
    **dict.fromkeys(VIDEOS, ("a video", "open it in a player")),
    ".npy": ("an array", "give it as a light, or read it with prt.light.read_coefficients"),
    ".onnx": ("a graph", "run it with ONNX Runtime, or give the bake that it was exported from"),
    ".safetensors": ("a transfer", "light it with `torchprt shade` or read it with prt.load_transfer"),
}
_STARTS = {
    b"\x76\x2f\x31\x01": (".exr", "an OpenEXR image"),
    b"#?": (".hdr", "a Radiance image"),
    b"\x89PNG": (".png", "a PNG picture"),
    b"\xff\xd8\xff": (".jpg", "a JPEG picture"),
    b"GIF8": (".gif", "a GIF picture"),
    b"II*\0": (".tif", "a TIFF picture"),
    b"MM\0*": (".tif", "a TIFF picture"),
    b"\x93NUMPY": (".npy", "an array of numpy"),
    b"NanoVDB": (".nvdb", "a NanoVDB grid"),
    b" BDV": (".vdb", "an OpenVDB grid"),
    b"ply\n": (".ply", "a PLY mesh"),
    b"ply\r": (".ply", "a PLY mesh"),
    b"glTF": (".glb", "a glTF mesh"),
}


def refuse_other(path: str | os.PathLike[str], wanted: str) -> None:
    """InputError if the suffix of `path` is that of a file of another kind than `wanted`, as "a mesh"."""
    kind, use = _KINDS.get(Path(path).suffix.lower(), (wanted, ""))
    if kind != wanted:
        raise InputError(f"{path} is {kind}, not {wanted}: {use}")


def check_readable(path: str | os.PathLike[str], advice: str = "check the name") -> Path:
    """`path`, if it is a file that can be read: asked before a library is, which may wait for a pipe for ever.

    Raises InputError if it is not; `advice` is what to do if nothing is there.
    """
    file = Path(path)
    try:
        mode = file.stat().st_mode
        if stat.S_ISDIR(mode):
            raise InputError(f"{file} cannot be read, it is a folder: give a file")
        if not stat.S_ISREG(mode):
            raise InputError(f"{file} cannot be read, it is a pipe or a device: copy what it holds into a file")
        with open(file, "rb"):
            return file
    except (FileNotFoundError, NotADirectoryError) as fault:
        raise InputError(f"{file} does not exist: {advice}") from fault
    except OSError as fault:
        raise InputError(f"{file} cannot be read ({fault.strerror}): check the name and its permissions") from fault


def nearest(suffix: str, known: Sequence[str]) -> str | None:
    """That of the `known` suffixes that `suffix` is probably meant to be; None if it resembles none."""
    return next(iter(difflib.get_close_matches(suffix.lower(), known, 1)), None)


def by_content(path: Path) -> tuple[str, str] | None:
    """The suffix that fits the first bytes of a file, and what they say that it is; None if they say nothing.

    Raises InputError if the file cannot be read.
    """
    check_readable(path)
    try:
        with path.open("rb") as stream:
            start = stream.read(16)
    except OSError as fault:
        raise InputError(f"{path} cannot be read ({fault.strerror}): check the name and its permissions") from fault
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return ".webp", "a WebP picture"
    if start[4:8] == b"ftyp":
        return ".mp4", "a video"
    if start[8:10] == b'{"':
        return ".safetensors", "a safetensors file"
    return next((found for lead, found in _STARTS.items() if start.startswith(lead)), None)


def kind_of(suffix: str) -> str | None:
    """What files of a suffix are: "a mesh", "an image", ...; None if that is not known."""
    return _KINDS.get(suffix.lower(), (None, ""))[0]
