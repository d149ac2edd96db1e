"""Materials of Wavefront .obj files: the .mtl beside them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from torchprt.errors import InputError
from torchprt.suffixes import check_readable

from .paint import NONE, Colour, Paint
from .texture import Map, Picture

OPTIONS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-texres": 1, "-clamp": 1, "-bm": 1, "-imfchan": 1}
"""Options of a map that have no part in an average or are rare, and how many words follow them."""

PLACED = ("-o", "-s", "-t")
"""Options of one to three numbers."""

LEFT = {
    "map_ks": "specular map",
    "map_ns": "shininess map",
    "map_pr": "roughness map",
    "map_pm": "metallic map",
    "map_d": "transparency map",
    "map_ke": "emission",
    "map_bump": "bump map",
    "bump": "bump map",
    "disp": "displacement",
    "refl": "reflection map",
    "ps": "sheen",
    "pc": "clearcoat",
}


def mtl_paints(source: Path, libraries: Sequence[str], names: Sequence[str]) -> tuple[Paint, ...]:
    """The materials `names` of an .obj file, as its `libraries`, named from its folder, say them.

    - `Kd` is linear, as exporters write it; the colours of `map_Kd` are sRGB, and are multiplied by it (by 1 where it
      is black, as some exporters write beside a map). Rows of the picture run up with v.
    - `Pr` and `Pm` are roughness and metallic as in glTF. Without them, and if `illum` is 2 or more, `Ks` is the
      reflectance along the normal and `Ns`, the exponent of a Blinn-Phong lobe, a width sqrt(2 / (Ns + 2)) of GGX.
    - `norm` or `map_Kn` is a normal map, in the tangent space of glTF. Height maps (`bump`) are left.
    - What is missing is said in `notes`: a file, a picture, a material.

    Source: the .mtl format of Wavefront; Walter, Marschner, Li and Torrance 2007, for the width of an exponent.
    """
    found: dict[str, Paint] = {}
    missing: list[str] = []
    for library in dict.fromkeys(libraries):
        path = _beside(source, library)
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except OSError as fault:
            missing.append(f"The library {path.name} cannot be read ({fault.strerror})")
            continue
        for name, lines in _blocks(text):
            # The first of a name counts, as in what most programs do.
            found.setdefault(name, _paint(path, name, lines))
    lost = missing[0] if missing else "In none of the libraries that the file names"
    return tuple(found.get(name, replace(NONE, name=name, notes=(lost,))) for name in names)


def _blocks(text: str) -> list[tuple[str, list[list[str]]]]:
    blocks: list[tuple[str, list[list[str]]]] = []
    for line in text.splitlines():
        words = line.split("#", 1)[0].split()
        if not words:
            continue
        if words[0].lower() == "newmtl":
            blocks.append((" ".join(words[1:]), []))
        elif blocks:
            blocks[-1][1].append(words)
    return blocks


def _paint(source: Path, name: str, lines: list[list[str]]) -> Paint:
    entries = {words[0].lower(): words[1:] for words in lines}
    notes: list[str] = []

    def number(key: str) -> float | None:
        try:
            value = float(entries[key][0])
        except (KeyError, IndexError, ValueError):
            return None
        return value if math.isfinite(value) else None

    def colour(key: str) -> Colour | None:
        words = entries.get(key, [])
        try:
            values = [float(word) for word in words[:3]]
        except ValueError:
            notes.append(f"{' '.join([key, *words])} is no RGB and is left out")
            return None
        if not values or not all(math.isfinite(value) for value in values):
            return None
        return (values[0], values[0], values[0]) if len(values) < 3 else (values[0], values[1], values[2])

    diffuse, specular = colour("kd"), colour("ks")
    colour_map = _map(source, entries["map_kd"]) if entries.get("map_kd") else None
    if colour_map is not None and diffuse == (0, 0, 0):
        notes.append("A black Kd beside a map is taken as white")
        diffuse = None
    roughness, metallic, model = number("pr"), number("pm"), number("illum")
    reflectance: Colour = (0.0, 0.0, 0.0)
    if roughness is not None or metallic is not None:
        reflectance = (0.04, 0.04, 0.04)
    elif specular is not None and (model is None or model >= 2):
        reflectance = specular
        exponent = max(number("ns") or 0.0, 0.0)
        # The square of roughness is the width.
        roughness = (2 / (exponent + 2)) ** 0.25
    # Exporters write normal maps under these two names; the height maps of map_Bump are left.
    normal = entries.get("norm") or entries.get("map_kn")
    left = [word for key, word in LEFT.items() if key in entries]
    if any(colour("ke") or ()):
        left.append("emission")
    clear = number("d") if "d" in entries else 1 - (number("tr") or 0)
    if clear is not None and clear < 1:
        left.append("transparency")
    return Paint(
        name,
        diffuse,
        colour_map,
        metallic=metallic or 0.0,
        roughness=1.0 if roughness is None else roughness,
        reflectance=reflectance,
        normal_map=_map(source, normal, srgb=False) if normal else None,
        left=tuple(dict.fromkeys(left)),
        notes=tuple(notes),
    )


def _map(source: Path, words: list[str], srgb: bool = True) -> Map | None:
    """The map that these words name, with its options."""
    scale, offset, clamp = [1.0, 1.0], [0.0, 0.0], False
    at = 0
    while at < len(words) and words[at].lower() in (*OPTIONS, *PLACED):
        option = words[at].lower()
        at += 1
        if option in OPTIONS:
            clamp |= option == "-clamp" and words[at : at + 1] == ["on"]
            at += OPTIONS[option]
            continue
        values: list[float] = []
        while at < len(words) and len(values) < 3 and _is_number(words[at]):
            values.append(float(words[at]))
            at += 1
        target = {"-s": scale, "-o": offset}.get(option)
        if target is not None:
            target[: len(values[:2])] = values[:2]
    name = " ".join(words[at:])
    wrap = "clamp" if clamp else "repeat"
    return picture_map(_beside(source, name), scale, offset, wrap, srgb) if name else None


def picture_map(
    path: Path,
    scale: Sequence[float] = (1, 1),
    offset: Sequence[float] = (0, 0),
    wrap: str = "repeat",
    srgb: bool = True,
) -> Map:
    """The map of a picture file whose rows run up with v."""
    # v of the lower edge is 0 there and 1 where pictures are looked up.
    matrix = np.array([[scale[0], 0, offset[0]], [0, -scale[1], 1 - offset[1]]], np.float64)

    def read() -> bytes:
        if not path.exists():
            raise InputError(f"the picture {path.name} is not there")
        return check_readable(path).read_bytes()

    return Map(Picture(path.name, read), srgb, matrix=matrix, wrap=(wrap, wrap))


def _beside(source: Path, name: str) -> Path:
    """The file of this name in the folder of `source`; Windows has other slashes, and exporters write whole paths."""
    path = source.parent / name.replace("\\", "/")
    return path if path.is_file() else next((p for p in [source.parent / path.name] if p.is_file()), path)


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False
