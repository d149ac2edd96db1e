"""Scenes from a small text file: several meshes, each with its own material, role and place."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from torchprt.errors import InputError
from torchprt.sh import yaw_pitch_roll

from .dress import object_of
from .ground import ground
from .material import Material
from .material_file import KEYS, given, read_material
from .mesh import Mesh
from .object import ROLES, Object
from .reading import read_mesh
from .scene import Scene
from .toml_file import colour, number, only, read_toml

PLACE = ("scale", "rotate", "move")


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """The scene of a .toml file: tables `[[object]]`, and `[ground]` if it stands on one. Files are named from there.

    - `mesh`: the file, as `read_mesh` takes it. `role`: "receiver" (default), "blocker" or "ground".
    - `material`: text or the name of a .toml, as `read_material` takes it; beside or instead of it the keys of such a
      .toml: `albedo`, `specular`, `two_sided`, `translucency`, `gloss`, `tabulated`, `subsurface`, `millimetres`.
      `material = "file"` and `albedo = "file"` are those of the mesh file; the latter is the default without a gloss,
      where it has any.
    - `scale` (a number above 0), `rotate` ([yaw, pitch, roll] in degrees about +y, +x, +z) and `move` ([x, y, z]), in
      this order, about the origin.
    - `[ground]`: `height` (the lowest point of all receivers by default) and `albedo` (.5).

    Raises InputError, naming the file and the key, for an unknown key or a value that is not of its kind, and as
    `read_mesh`, `read_material`, `Object` and `Scene.on_ground`.
    """
    source = Path(path)
    content = read_toml(source)
    only(source, content, ("object", "ground"))
    tables = content.get("object")
    if not isinstance(tables, list) or not tables or not all(isinstance(each, dict) for each in tables):
        raise InputError(f"{source} has no objects: give each a table [[object]] with its mesh")
    objects = [_object(source, table) for table in tables]
    if "ground" in content:
        objects += _ground(source, content["ground"], objects)
    try:
        return Scene(objects)
    except InputError as fault:
        raise InputError(f"{source}: {fault}") from fault


def _object(source: Path, table: dict[str, Any]) -> Object:
    only(source, table, ("mesh", "role", "material", *KEYS, *PLACE), " in [[object]]")
    if not isinstance(table.get("mesh"), str):
        raise InputError(f'{source} has an [[object]] without a mesh: give the name of its file, mesh = "model.ply"')
    role = table.get("role", "receiver")
    if role not in ROLES:
        raise InputError(f"{source} has role = {role!r}: use one of {', '.join(ROLES)}")
    try:
        return _dressed(source, table, role)
    except InputError as fault:
        text = str(fault)
        raise InputError(text if text.startswith(str(source.parent)) else f"{source}: {text}") from fault


def _dressed(source: Path, table: dict[str, Any], role: str) -> Object:
    path = source.parent / table["mesh"]
    if role == "blocker":
        return Object(_placed(source, table, read_mesh(path)), _material(source, table), role)
    said = {key: value for key, value in table.items() if key in KEYS}
    of_file = {key: table[key] for key in ("albedo", "material") if table.get(key) == "file"}
    if of_file or not {"albedo", "material", "gloss", "tabulated", "mirror", "subsurface"} & table.keys():
        # What the table says beside it replaces what the file says.
        rest = {key: value for key, value in said.items() if key not in of_file}
        if "material" in of_file and {"gloss", "tabulated"} & rest.keys():
            raise InputError(f"{source} has both material and gloss in an [[object]]: keep one")
        plain = {key: value for key, value in table.items() if key not in of_file}
        material = None if "material" not in table or "material" in of_file else _material(source, plain)
        dressed = object_of(path, of_file.get("albedo"), None, of_file.get("material", material))
        return Object(_placed(source, table, dressed.mesh), replace(dressed.material, **given(source, rest)), role)
    return Object(_placed(source, table, read_mesh(path)), _material(source, table), role)


def _material(source: Path, table: dict[str, Any]) -> Material:
    said = {key: table[key] for key in KEYS if key in table}
    if "material" not in table:
        return Material(**given(source, said))
    name = table["material"]
    if not isinstance(name, str):
        raise InputError(f'{source} has material = {name!r}: give text, "ggx:0.3", or the name of a .toml file')
    for key in ("gloss", "tabulated"):
        if key in said:
            raise InputError(f"{source} has both material and {key} in an [[object]]: keep one")
    is_file = name.lower().endswith(".toml")
    return replace(read_material(source.parent / name if is_file else name), **given(source, said))


def _placed(source: Path, table: dict[str, Any], mesh: Mesh) -> Mesh:
    if not any(key in table for key in PLACE):
        return mesh
    scale = number(source, "scale", table.get("scale", 1))
    if not 0 < scale < float("inf"):
        raise InputError(f"{source} has scale = {scale:g}: give a number above 0")
    angles, move = (_three(source, table, key) for key in ("rotate", "move"))
    turn = yaw_pitch_roll(angles)
    positions = scale * mesh.positions @ turn.T + move
    extent = (positions.amax(0) - positions.amin(0)).tolist()
    return replace(
        mesh,
        positions=positions,
        normals=mesh.normals @ turn.T,
        tangents=None if mesh.tangents is None else mesh.tangents @ turn.T,
        report=replace(mesh.report, extent=tuple(extent)),
    )


def _three(source: Path, table: dict[str, Any], key: str) -> torch.Tensor:
    value = table.get(key, [0, 0, 0])
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{source} has {key} = {value!r}: give three numbers in brackets")
    values = torch.tensor([number(source, key, each) for each in value], dtype=torch.float64)
    if not bool(values.isfinite().all()):
        raise InputError(f"{source} has {key} = {value!r}: the numbers must be finite")
    return values


def _ground(source: Path, table: Any, objects: list[Object]) -> list[Object]:
    if not isinstance(table, dict):
        raise InputError(f"{source} has ground = {table!r}: write it as a table, [ground], with height and albedo")
    only(source, table, ("height", "albedo"), " in [ground]")
    height = number(source, "height", table["height"]) if "height" in table else None
    albedo = colour(source, table, "albedo") if "albedo" in table else 0.5
    try:
        return ground(objects, height, albedo)
    except InputError as fault:
        raise InputError(f"{source}: {fault}") from fault
