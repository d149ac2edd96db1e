"""Materials from text: a word for the command line, or a .toml file."""

import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torchprt import brdf
from torchprt.brdf import Brdf, Tabulated, parse
from torchprt.errors import InputError
from torchprt.suffixes import check_readable

from .material import Material
from .subsurface import MATERIALS, WORD
from .toml_file import colour, number, only, read_toml

KEYS = ("albedo", "two_sided", "translucency", "specular", "gloss", "tabulated", "mirror", "subsurface", "millimetres")

# Linear RGB along the normal. Source: Akenine-Moeller and others, Real-Time Rendering, fourth edition, table 9.2.
METALS = {
    "aluminium": (0.913, 0.922, 0.924),
    "chromium": (0.549, 0.556, 0.554),
    "copper": (0.955, 0.638, 0.538),
    "gold": (1.0, 0.782, 0.344),
    "iron": (0.562, 0.565, 0.578),
    "silver": (0.972, 0.960, 0.915),
}
EXAMPLES = (
    '"phong:40", "ggx:0.3,0.04", "ward:0.1,0.4", "membrane:0.5", "mirror:.95,.64,.54", "marble@100" or the name of a '
    ".toml file"
)


def read_material(text: str | os.PathLike[str]) -> Material:
    """The material that `text` says: a gloss, a membrane, a mirror, or the name of a .toml file.

    - "ggx:0.3,0.04", or any reflectance that `torchprt.brdf.parse` knows: that gloss over a black body.
    - "membrane:0.5": a diffuse sheet of that translucency, albedo .5.
    - "mirror", "mirror:.8", "mirror:.95,.64,.54" (linear RGB along the normal) or "mirror:gold", any of `METALS`.
    - "marble@100" or "subsurface:0.74,0.88,1.01,0.032,0.17,0.48,1.3@100": a body of that medium (see
      `read_subsurface`), of which a unit is 100 mm; with a gloss over it "skin1@100+ggx:0.35,0.03".
    - "leaf.toml": a file of the keys `albedo`, `two_sided`, `translucency`, `specular`, `mirror`, `subsurface`,
      `millimetres` (as `Material` takes them, a mirror also by its metal) and `gloss`, either text as above or a table
      of a `model` and its numbers by name (`roughness`, `f0`, `exponent`, ...); or instead of `gloss`, `tabulated`, the
      name of a .npy file of measured values as `brdf.Tabulated` takes them, beside the .toml.

    Raises InputError, naming the file and the key, for anything else and as `Material` does.
    """
    name = os.fspath(text)
    if name.lower().endswith(".toml"):
        return _material(Path(name), read_toml(Path(name)))
    model, _, numbers = name.strip().partition(":")
    if model == "membrane":
        try:
            return Material(translucency=float(numbers))
        except InputError as fault:
            raise InputError(f"material '{name}': {fault}") from fault
        except ValueError as fault:
            raise InputError(f"material '{name}' needs its translucency: write it as membrane:0.5") from fault
    if model == "mirror":
        return _mirror(name, numbers)
    if model == WORD or model.partition("@")[0].partition("+")[0] in MATERIALS:
        return _body(name)
    try:
        return Material(gloss=parse(name))
    except InputError as fault:
        raise InputError(f"material '{name}' cannot be used, give {EXAMPLES} ({fault})") from fault


def _body(name: str) -> Material:
    body, plus, gloss = name.strip().partition("+")
    medium, at, millimetres = body.partition("@")
    try:
        scale = float(millimetres) if at else None
    except ValueError as fault:
        raise InputError(
            f"material '{name}' has no number behind @: write how many mm a unit of the mesh is, {medium}@100"
        ) from fault
    try:
        return Material(subsurface=medium, millimetres=scale, gloss=gloss if plus else None)
    except InputError as fault:
        raise InputError(f"material '{name}': {fault}") from fault


def _mirror(name: str, numbers: str) -> Material:
    if numbers in METALS:
        return Material(mirror=METALS[numbers])
    try:
        share = [float(part) for part in numbers.split(",")] if ":" in name else [1.0]
    except ValueError:
        share = []
    if len(share) not in (1, 3):
        raise InputError(
            f"material '{name}' is no mirror: write mirror, one number or three, mirror:.95,.64,.54, or a metal "
            f"({', '.join(METALS)})"
        )
    try:
        return Material(mirror=share)
    except InputError as fault:
        raise InputError(f"material '{name}': {fault}") from fault


def _material(source: Path, content: dict[str, Any]) -> Material:
    only(source, content, KEYS)
    try:
        return Material(**given(source, content))
    except InputError as fault:
        raise InputError(f"{source}: {fault}") from fault


def given(source: Path, content: dict[str, Any]) -> dict[str, Any]:
    """The arguments of `Material` that the keys `KEYS` of a table in the .toml file `source` say."""
    if "gloss" in content and "tabulated" in content:
        raise InputError(f"{source} has both gloss and tabulated: keep one")
    found: dict[str, Any] = {}
    if "albedo" in content:
        found["albedo"] = content["albedo"] if content["albedo"] == "vertex" else colour(source, content, "albedo")
    if "specular" in content:
        found["specular"] = colour(source, content, "specular")
    if "mirror" in content:
        found["mirror"] = METALS.get(str(content["mirror"])) or colour(source, content, "mirror")
    if "subsurface" in content:
        if not isinstance(content["subsurface"], str):
            raise InputError(f'{source} has subsurface = {content["subsurface"]!r}: give text, "marble"')
        found["subsurface"] = content["subsurface"]
    if "millimetres" in content:
        found["millimetres"] = number(source, "millimetres", content["millimetres"])
    if "translucency" in content:
        found["translucency"] = number(source, "translucency", content["translucency"])
    if "two_sided" in content:
        if not isinstance(content["two_sided"], bool):
            raise InputError(f"{source} has two_sided = {content['two_sided']!r}: give true or false")
        found["two_sided"] = content["two_sided"]
    if "gloss" in content:
        found["gloss"] = _gloss(source, content["gloss"])
    if "tabulated" in content:
        found["gloss"] = _table(source, content["tabulated"])
    return found


def _gloss(source: Path, value: Any) -> Brdf:
    if isinstance(value, dict):
        return _gloss_table(source, value)
    if not isinstance(value, str):
        raise InputError(f'{source} has gloss = {value!r}: give text as "ggx:0.3,0.04", or a table [gloss]')
    try:
        return parse(value)
    except InputError as fault:
        raise InputError(f"{source} has a gloss that cannot be used ({fault})") from fault


def _gloss_table(source: Path, table: dict[str, Any]) -> Brdf:
    models: dict[str, type[brdf.Model]] = {
        model.name: model for model in (brdf.Lambert, brdf.Phong, brdf.BlinnPhong, brdf.GGX, brdf.Ward)
    }
    name = table.get("model")
    if not isinstance(name, str) or name not in models:
        raise InputError(f"{source} has [gloss] model = {name!r}: use one of {', '.join(models)}")
    numbers = {key: number(source, f"[gloss] {key}", value) for key, value in table.items() if key != "model"}
    wanted = [field.name for field in fields(models[name])]  # type: ignore[arg-type]
    unknown = [key for key in numbers if key not in wanted]
    if unknown:
        raise InputError(f"{source} has an unknown key {unknown[0]!r} in [gloss]: {name} takes {', '.join(wanted)}")
    try:
        return models[name](**numbers)
    except InputError as fault:
        raise InputError(f"{source} has a [gloss] that cannot be used ({fault})") from fault
    except TypeError as fault:
        raise InputError(f"{source} has a [gloss] without all its numbers: {name} takes {', '.join(wanted)}") from fault


def _table(source: Path, name: Any) -> Brdf:
    if not isinstance(name, str):
        raise InputError(f'{source} has tabulated = {name!r}: give the name of a .npy file, "paint.npy"')
    path = source.parent / name
    if path.exists():
        check_readable(path)
    try:
        values = np.load(path, allow_pickle=False)
    except FileNotFoundError as fault:
        raise InputError(f"{source} names {path} as tabulated, which does not exist: check the name") from fault
    except (OSError, ValueError, EOFError) as fault:
        raise InputError(f"{source} names {path} as tabulated, which is not an .npy file: check the name") from fault
    if not np.issubdtype(values.dtype, np.number) or np.issubdtype(values.dtype, np.complexfloating):
        raise InputError(f"{path} holds {values.dtype}: give real numbers")
    try:
        return Tabulated(torch.from_numpy(values.astype(np.float64)), spec=f"tabulated:{path.name}")
    except InputError as fault:
        raise InputError(f"{path} cannot be used as a reflectance ({fault})") from fault
