"""Objects of mesh files: what a file says of its own materials, and what is said instead."""

import os
import warnings
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from torchprt.errors import InputError
from torchprt.words import count

from .detail import Detail
from .energy import EnergyWarning, reflected
from .glosses import few_glosses
from .material import Albedo, Material
from .material_file import read_material
from .mesh import Mesh
from .object import Object
from .paint import Paint, listed
from .surface import Surface, read_surface

Source = str | os.PathLike[str] | Mesh
"""A mesh, or the name of the file that holds it."""

BRIGHT = 0.9
"""Nothing outdoors has a higher albedo than fresh snow."""


def object_of(
    source: Source,
    albedo: Albedo | None = None,
    two_sided: bool | None = None,
    material: Material | str | None = None,
    role: str = "receiver",
) -> Object:
    """The object of a mesh or a mesh file.

    - `albedo` "file" is the colour of the file: base colour factor times texture times vertex colour. It is the
      default without a `material`, where the file has any; else .5.
    - `material` "file" takes the gloss of the file as well (see `file_material`); else a material, or text as
      `read_material` takes. An albedo given beside it replaces that of the material.
    - `two_sided` None is as the material says, and without one (or of the file) as the file says.

    Raises InputError as `read_surface`, `read_material` and `Object`, or if "file" is asked for and there is nothing.
    """
    whole = isinstance(material, str) and material == "file"
    told = isinstance(albedo, str) and albedo == "file"
    if isinstance(source, Mesh):
        if whole or told:
            raise InputError(f'{source.name} is a mesh, of which "file" says nothing: give the name of the file')
        mesh, chosen = source, _given(material, albedo)
    else:
        surface = read_surface(source)
        mesh = surface.mesh
        if whole:
            if not surface.paints:
                raise InputError(f'{source} has no materials for material "file": give one, as "ggx:0.3,0.04"')
            chosen = file_material(surface, gloss=True)
        elif told or (albedo is None and material is None and surface.coloured):
            if not surface.coloured:
                raise InputError(f'{source} has no colours for albedo "file": give the albedo as numbers')
            chosen = file_material(surface, gloss=False)
            if material is not None:
                chosen = replace(_given(material, None), albedo=chosen.albedo, notes=chosen.notes, detail=chosen.detail)
        else:
            chosen = _given(material, albedo)
            if material is None and albedo is None and surface.paints:
                # It may have lost them with a file that is not there.
                notes = [f"The file says no colour: albedo {chosen.albedo:g}.", *_notes(surface, (), gloss=False)]
                chosen = replace(chosen, notes=tuple(notes), detail=Detail(surface))
        if material is None and not whole:
            chosen = replace(chosen, two_sided=surface.two_sided)
        if whole and not told and albedo is not None:
            chosen = replace(chosen, albedo=albedo)
    return Object(mesh, chosen if two_sided is None else _quietly(chosen, two_sided=two_sided), role)


def _given(material: Material | str | None, albedo: Albedo | None) -> Material:
    if material is None:
        return Material(albedo)
    chosen = read_material(material) if isinstance(material, str) else material
    return chosen if albedo is None else replace(chosen, albedo=albedo)


def file_material(surface: Surface, gloss: bool = False) -> Material:
    """The material of a file, with a value for every vertex.

    Without `gloss` it is diffuse: the albedo is the base colour, of a metal too. With it there is GGX on it, of width
    roughness^2 and of the reflectance along the normal of the metallic-roughness model, lerp(.04, base, metallic); its
    colour is the `specular` weight, so at grazing angles a metal keeps its tint. At most 12 different ones stand for
    those of all vertices. The body is base (1 - metallic), times what the gloss lets through of a uniform light, which
    is the glTF's 1 - F in the mean over views.

    `notes` say what was taken and what was left; `detail` keeps the file for what lies between vertices (`Finish`).
    Source: the specification of glTF 2.0, appendix B.
    """
    look = surface.look(gloss)
    notes = _notes(surface, look.notes, gloss)
    body, said = _shares(look.diffuse + (0 if gloss else look.metal))
    if said:
        notes.append(f"Colours {said}.")
    mean = float(body.max(axis=1).mean())
    if mean > BRIGHT:
        notes.append(f"Albedo is {mean:.2g} in the mean: light that bounces dies slowly.")
    two_sided = surface.two_sided
    if not gloss:
        return _diffuse(surface, body, notes, gloss)
    reflectance, _ = _shares(look.dielectric + look.metal)
    glosses, change = few_glosses(look.roughness, reflectance.max(axis=1))
    if glosses is None:
        notes.append("No material has a gloss.")
        return _diffuse(surface, body, notes, gloss)
    weight = np.ones_like(reflectance)
    for number, brdf in enumerate(glosses.models):
        here = (glosses.of_vertex == number).numpy()
        weight[here] = np.clip(reflectance[here] / brdf.f0, 0, 1)  # type: ignore[attr-defined]
        body[here] *= 1 - weight[here] * reflected(brdf).mean
    rounded = f", roughness rounded by up to {change:.2g}" if change > 5e-4 else ""
    notes.append(f"Gloss of the file: {count(len(glosses.models), 'kind')} of GGX{rounded}.")
    albedo, specular = torch.from_numpy(body).float(), torch.from_numpy(weight).float()
    with warnings.catch_warnings(record=True) as caught:
        # The Lambertian body lacks the 1 - F toward grazing views, of which the file knows; it is said, once.
        warnings.simplefilter("always", EnergyWarning)
        made = Material(
            albedo, two_sided, glosses, specular, detail=Detail(surface, albedo, specular, glosses, gloss=True)
        )
    if caught:
        notes.append("Toward grazing views it is brighter than a uniform light around it, on the whole it is not.")
    return _quietly(made, notes=tuple(notes))


def _diffuse(surface: Surface, body: np.ndarray, notes: Iterable[str], gloss: bool) -> Material:
    albedo = torch.from_numpy(body).float()
    return Material(albedo, surface.two_sided, notes=tuple(notes), detail=Detail(surface, albedo, gloss=gloss))


def _quietly(material: Material, **changes: Any) -> Material:
    """The same with changes that have nothing to do with its energy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EnergyWarning)
        return replace(material, **changes)


def _shares(values: np.ndarray) -> tuple[np.ndarray, str]:
    """Values within [0, 1], and in words which were not."""
    finite = np.isfinite(values)
    outside = finite & ((values < -1e-4) | (values > 1 + 1e-4))
    words = []
    if outside.any():
        low, high = values[finite].min(), values[finite].max()
        where = count(int(outside.any(axis=1).sum()), "vertex")
        words.append(f"of {where}, from {low:.3g} to {high:.3g}, are taken as within 0 and 1")
    if not finite.all():
        where = count(int((~finite).any(axis=1).sum()), "vertex")
        words.append(f"of {where} that are not finite are taken as .5")
    return np.clip(np.where(finite, values, 0.5), 0, 1), " and ".join(words)


def _notes(surface: Surface, said: Iterable[str], gloss: bool) -> list[str]:
    """What is taken of the file and what is left, in sentences."""
    used = surface.used
    notes = []
    pictured = [paint for paint in used if paint.colour_map is not None]
    plain = [paint for paint in used if paint.colour_map is None and paint.coloured]
    taken = []
    if pictured:
        taken.append(f"textures of {listed([paint.name for paint in pictured])}")
    if plain:
        taken.append(f"base colour of {listed([paint.name for paint in plain])}")
    if surface.raw.tint is not None:
        taken.append("vertex colours")
    if taken:
        notes.append(f"Albedo of the file: {', '.join(taken)}.")
    left: dict[str, list[str]] = defaultdict(list)
    for paint in used:
        for what in paint.left:
            left[what].append(paint.name)
        if not gloss and paint.glossy:
            left["gloss"].append(paint.name)
    if left:
        words = ", ".join(f"{what} of {listed(names)}" for what, names in left.items())
        notes.append(f"Left out: {words}.{' Material file takes the gloss.' if 'gloss' in left else ''}")
    bumpy = [paint.name for paint in used if paint.normal_map is not None]
    if bumpy:
        notes.append(f"At texels, not at vertices: normal map of {listed(bumpy)}.")
    metals = [paint.name for paint in used if paint.metallic > 0 and paint.gloss_map is None]
    if metals and taken and not gloss:
        notes.append(f"Metal is taken as diffuse, of its base colour: {listed(metals)}.")
    decided: dict[str, list[str]] = defaultdict(list)
    for paint in used:
        for note in paint.notes:
            decided[note].append(paint.name)
    notes += [f"{note}: {listed(names)}." for note, names in decided.items()]
    notes += [note if note.endswith(".") else f"{note}." for note in said]
    notes += _sides(surface, used)
    return notes


def _sides(surface: Surface, used: Iterable[Paint]) -> list[str]:
    double = [paint.name for paint in used if paint.two_sided]
    if not double:
        return []
    if bool(surface.two_sided.any()):
        return [f"Both sides of {listed(double)} receive light."]
    return [f"Double-sided, of a closed surface, whose outer side alone receives light: {listed(double)}."]
