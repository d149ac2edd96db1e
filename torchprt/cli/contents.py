"""What is in a file or a folder, in lines: whatever the project reads or writes."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from torchprt.cli.report import describe, details, triple
from torchprt.errors import InputError
from torchprt.suffixes import IMAGES, MESHES, VIDEOS, by_content, kind_of, nearest
from torchprt.words import count

if TYPE_CHECKING:
    import numpy as np

# Lights of higher orders are not made; as many numbers are radiance.
HIGHEST_ORDER = 64


def contents(path: Path) -> list[str]:
    """What `path` holds. Raises InputError, naming it, if that cannot be told or is not what its name says."""
    if path.is_dir():
        return _folder(path)
    found, suffix = by_content(path), path.suffix.lower()
    if suffix == ".partial":
        return _stopped_compression(path)
    reader = READERS.get(suffix)
    if found is not None and kind_of(found[0]) != kind_of(suffix):
        named = f"its name ends in {suffix}" if suffix else "its name has no suffix"
        raise InputError(f"{path} is {found[1]}, but {named}: rename it to {path.with_suffix(found[0]).name}")
    if reader is None:
        near = nearest(suffix, list(READERS)) if suffix else None
        hint = f"did you mean {path.with_suffix(near)}" if near else f"it is none of {', '.join(READERS)}"
        raise InputError(f"{path} is no file that can be told of: {hint}")
    lines = reader(path)
    if found is not None and suffix in IMAGES and READERS.get(found[0]) and found[0] not in _same(suffix):
        lines.append(f"It is {found[1]}, whatever its name says: rename it to {path.with_suffix(found[0]).name}")
    return lines


def _same(suffix: str) -> tuple[str, ...]:
    pairs = ((".jpg", ".jpeg"), (".tif", ".tiff"))
    return next((pair for pair in pairs if suffix in pair), (suffix,))


def _transfer(path: Path) -> list[str]:
    from torchprt.transfer import load

    # The numbers themselves, which may be larger than memory, say nothing here.
    loaded = load(path)
    told = f"{count(loaded.rays, 'ray')} a receiver, seed {loaded.seed}, baked by torchprt {loaded.version}"
    return [f"{path}: {describe(loaded)}", *details(loaded), told]


def _d3dx(path: Path) -> list[str]:
    from torchprt.transfer import load

    loaded = load(path)
    place = "" if "rows" in loaded.receivers.metadata() else "; give its mesh in Python, transfer.load_d3dx, to draw it"
    told = f"saved by D3DX, which says neither albedo nor rays nor error{place}"
    return [f"{path}: {describe(loaded)}", *details(loaded), told]


def _graph(path: Path) -> list[str]:
    from torchprt.onnx import describe as of_graph

    return [f"{name}: {value}" for name, value in of_graph(path).items()]


def _mesh(path: Path) -> list[str]:
    from torchprt.scene import load

    return str(load(path)).splitlines()


def _text(path: Path) -> list[str]:
    """A material, or a scene of several meshes."""
    from torchprt.scene import load, read_material

    try:
        text = path.read_text(encoding="utf-8")
    except ValueError as fault:
        raise InputError(f"{path} is not a .toml file ({fault}): mend it") from fault
    if any(line.replace(" ", "").startswith(("[[object]]", "[ground]")) for line in text.splitlines()):
        return [f"{path}: scene", *str(load(path)).splitlines()]
    material = read_material(path)
    lines = [f"{path}: material, albedo {_numbers(material.albedo)}"]
    if material.brdf is not None:
        lines.append(f"Gloss {material.brdf.spec}, specular {_numbers(material.specular)}")
    if material.translucency:
        lines.append(f"Translucency {material.translucency:g}, both sides record.")
    if material.medium is not None:
        lines.append(f"Subsurface {material.medium.text}, a unit is {material.millimetres:g} mm.")
    if material.two_sided:
        lines.append("Both sides reflect.")
    return lines


def _image(path: Path) -> list[str]:
    from torchprt.light import read_with_report

    if path.suffix.lower() in (".gif", ".webp", ".png"):
        from PIL import Image, UnidentifiedImageError

        try:
            with Image.open(path) as opened:
                pictures = getattr(opened, "n_frames", 1)
                seconds = 0.0
                for number in range(pictures if pictures > 1 else 0):
                    opened.seek(number)
                    # Of the picture that is decoded, in milliseconds.
                    opened.load()
                    seconds += opened.info.get("duration", 0) / 1000
                if pictures > 1:
                    return [_animation(path, pictures, opened.size, seconds)]
        except (UnidentifiedImageError, OSError, SyntaxError, ValueError, EOFError):
            pass  # Told below, by what reads pictures.
    image, report = read_with_report(path, repair=True)
    height, width, _ = image.shape
    shape = ", as an environment has" if width == 2 * height else ", not twice as wide as high: no environment"
    return [f"{path}: {width} x {height} pixels{shape}", *report.sentences()]


def _video(path: Path) -> list[str]:
    from torchprt.preview.video import measure_video

    pictures, size, seconds = measure_video(path)
    return [_animation(path, pictures, size, seconds)]


def _animation(path: Path, pictures: int, size: tuple[int, int], seconds: float) -> str:
    pace = f", {seconds:.3g} s, {pictures / seconds:.3g} a second" if seconds else ""
    return f"{path}: {count(pictures, 'picture')} of {size[0]} x {size[1]} pixels{pace}"


def _array(path: Path) -> list[str]:
    """A light, radiance of vertices, poses of them, or numbers of another meaning."""
    import numpy as np

    from torchprt.light import read_coefficients

    try:
        with path.open("rb") as stream:
            values = np.lib.format.read_array(stream, allow_pickle=False)
    except Exception as fault:  # Damaged headers end in exceptions of any kind.
        raise InputError(f"{path} is not a whole .npy file of numbers: write it again") from fault
    if values.dtype.kind not in "fiu":
        raise InputError(f"{path} holds {values.dtype} {list(values.shape)}, no numbers: write it again")
    if values.ndim == 2 and values.shape[1] == 3:
        order = math.isqrt(len(values))
        if order**2 == len(values) and 0 < order <= HIGHEST_ORDER:
            mean = triple(read_coefficients(path)[0] / math.sqrt(4 * math.pi))
            return [f"{path}: light of order {order}, mean radiance {mean}"]
        return [f"{path}: radiance of {count(len(values), 'vertex')}, {_span(values)}"]
    if values.ndim == 3 and values.shape[2] == 3:
        poses, vertices, _ = values.shape
        return [f"{path}: {count(poses, 'pose')} of {count(vertices, 'vertex')}, {_span(values)}"]
    return [f"{path}: {values.dtype} of shape {list(values.shape)}, {_span(values)}"]


def _volume(path: Path) -> list[str]:
    from torchprt.scene import read_volume

    return [f"{path}: volume of {read_volume(path)}"]


def _span(values: np.ndarray) -> str:
    import numpy as np

    bad = int((~np.isfinite(values)).sum())
    if not values.size or bad:
        return f"{count(bad, 'number')} not finite" if bad else "empty"
    span = f"from {values.min():.4g} to {values.max():.4g}"
    return f"mean {triple(values.mean(0))}, {span}" if values.ndim == 2 and values.shape[1] == 3 else span


def _folder(path: Path) -> list[str]:
    """A page, or what a stopped bake keeps."""
    manifest, page = path / "manifest.json", path / "scene.json"
    chunks = sorted(path.glob("chunk-*.safetensors"))
    size = sum(each.stat().st_size for each in path.rglob("*") if each.is_file()) / 2**20
    if page.is_file():
        try:
            about = json.loads(page.read_text(encoding="utf-8"))
            lights = ", ".join(each["name"] for each in about["environments"])
            lines = [
                f"{path}: page '{about['title']}', {size:.1f} MB, {about['subtitle']}, {about['transport']}, "
                f"{count(about['vertices'], 'vertex')}",
                f"Lights {lights}; look at it with: torchprt serve {path}",
            ]
        except (ValueError, KeyError, TypeError) as fault:
            raise InputError(f"{path} is a page whose scene.json is damaged: export it again") from fault
        return lines
    if manifest.is_file():
        output = path.with_suffix("") if path.suffix == ".partial" else path
        return [
            f"{path}: a bake that was stopped, {count(len(chunks), 'chunk')}, {size:.1f} MB",
            f"The same `torchprt bake` with -o {output} goes on from there; remove the folder to begin anew.",
        ]
    raise InputError(f"{path} is a folder, and neither a page nor what a stopped bake keeps: give files")


def _stopped_compression(path: Path) -> list[str]:
    size = path.stat().st_size / 2**20
    return [
        f"{path}: a compression that was stopped, {size:.1f} MB",
        f"The same `torchprt compress` with -o {path.with_suffix('')} goes on from there; remove it to begin anew.",
    ]


def _numbers(values: Any) -> str:
    import torch

    return values if isinstance(values, str) else ", ".join(f"{each:.3g}" for each in torch.as_tensor(values).flatten())


READERS: dict[str, Callable[[Path], list[str]]] = {
    ".safetensors": _transfer,
    **dict.fromkeys((".prt", ".pca"), _d3dx),
    ".onnx": _graph,
    ".npy": _array,
    **dict.fromkeys((".npz", ".vdb", ".nvdb"), _volume),
    ".toml": _text,
    **dict.fromkeys(MESHES, _mesh),
    **dict.fromkeys(IMAGES, _image),
    **dict.fromkeys(VIDEOS, _video),
}
