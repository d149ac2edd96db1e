"""Materials of a glTF file."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from torchprt.errors import InputError

from .gltf_document import Document
from .paint import NONE, Colour, Paint
from .texture import Map, Picture

CLAMP, MIRROR, NEAREST = 33071, 33648, 9728
TRANSFORM = "KHR_texture_transform"
# What a texture may name instead of a .png or .jpg, the first that is there.
SOURCES = ("EXT_texture_webp", "EXT_texture_avif", "KHR_texture_basisu")
WORDS = {
    "KHR_materials_anisotropy": "anisotropy",
    "KHR_materials_clearcoat": "clearcoat",
    "KHR_materials_diffuse_transmission": "diffuse transmission",
    "KHR_materials_dispersion": "dispersion",
    "KHR_materials_iridescence": "iridescence",
    "KHR_materials_sheen": "sheen",
    "KHR_materials_subsurface": "subsurface scattering",
    "KHR_materials_transmission": "transmission",
    "KHR_materials_volume": "volume",
}
TAKEN = ("KHR_materials_emissive_strength", "KHR_materials_ior", "KHR_materials_specular", "KHR_materials_unlit")
GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"


def gltf_paints(document: Document) -> tuple[Paint, ...]:
    """The materials of a document in its order, and behind them the one of primitives that name none.

    Base colour factors are linear and their textures sRGB; roughness and metallic textures are linear. Read are
    KHR_texture_transform, KHR_materials_unlit, _ior, _specular without its textures, and of the retired
    _pbrSpecularGlossiness the diffuse part and the factors. What else a material has stands in `left`.

    Raises InputError, naming the file, where it names something that does not exist.
    Source: the specification of glTF 2.0, section 3.9, and those of the extensions.
    """
    entries = document.all("materials")
    found = [_paint(document, entry, entry.get("name") or f"material {n}") for n, entry in enumerate(entries)]
    # Section 3.7.2.1: without a material all properties have their defaults, of which a white metal is meant by none.
    return (*found, NONE)


def _paint(document: Document, entry: Mapping[str, Any], name: str) -> Paint:
    more = entry.get("extensions", {})
    core = entry.get("pbrMetallicRoughness", {})
    left = _left(entry, more)
    notes: list[str] = []
    if GLOSSINESS in more:
        retired = more[GLOSSINESS]
        if "specularGlossinessTexture" in retired:
            left.append("specular-glossiness map")
        factor = retired.get("diffuseFactor")
        metallic, gloss_map, colour_entry = 0.0, None, retired.get("diffuseTexture")
        roughness = 1 - float(retired.get("glossinessFactor", 1))
        reflectance = _colour(retired.get("specularFactor", (1, 1, 1)))
    else:
        factor = core.get("baseColorFactor")
        metallic, roughness = float(core.get("metallicFactor", 1)), float(core.get("roughnessFactor", 1))
        gloss_map = _map(document, core.get("metallicRoughnessTexture"), srgb=False)
        colour_entry = core.get("baseColorTexture")
        reflectance = _reflectance(more)
    if "KHR_materials_unlit" in more:
        metallic, roughness, gloss_map, reflectance = 0.0, 1.0, None, (0.0, 0.0, 0.0)
        notes.append("Unlit, the colour is taken as albedo")
    alpha = entry.get("alphaMode", "OPAQUE")
    if alpha != "OPAQUE":
        left.append("transparency" if alpha == "BLEND" else "cut-out holes")
    normal = entry.get("normalTexture")
    return Paint(
        name,
        None if factor is None else _colour(factor),
        _map(document, colour_entry, srgb=True),
        alpha if alpha in ("MASK", "BLEND") else "OPAQUE",
        float(entry.get("alphaCutoff", 0.5)),
        metallic,
        roughness,
        gloss_map,
        reflectance,
        bool(entry.get("doubleSided", False)),
        _map(document, normal, srgb=False),
        1.0 if normal is None else float(normal.get("scale", 1)),
        tuple(left),
        tuple(notes),
    )


def _left(entry: Mapping[str, Any], more: Mapping[str, Any]) -> list[str]:
    left = ["occlusion"] if "occlusionTexture" in entry else []
    if ("emissiveTexture" in entry and any(entry.get("emissiveFactor", ()))) or any(entry.get("emissiveFactor", ())):
        left.append("emission")
    known = {name: WORDS.get(name, name) for name in more if name not in (*TAKEN, GLOSSINESS)}
    left += known.values()
    if any("Texture" in key for key in more.get("KHR_materials_specular", {})):
        left.append("specular maps")
    return left


def _reflectance(more: Mapping[str, Any]) -> Colour:
    """Of what is not metallic along the normal, by index of refraction and KHR_materials_specular."""
    index = float(more.get("KHR_materials_ior", {}).get("ior", 1.5))
    # An index of 0 stands for infinite.
    base = 1.0 if index == 0 else ((index - 1) / (index + 1)) ** 2
    specular = more.get("KHR_materials_specular", {})
    weight = float(specular.get("specularFactor", 1))
    tint = _colour(specular.get("specularColorFactor", (1, 1, 1)))
    return tuple(min(base * channel, 1.0) * weight for channel in tint)  # type: ignore[return-value]


def _colour(values: Any) -> Colour:
    red, green, blue = (float(value) for value in values[:3])
    return red, green, blue


def _map(document: Document, entry: Mapping[str, Any] | None, srgb: bool) -> Map | None:
    if entry is None:
        return None
    texture = document.entry("textures", entry["index"])
    named = [texture["source"]] if "source" in texture else []
    others = texture.get("extensions", {})
    named += [others[name]["source"] for name in SOURCES if "source" in others.get(name, {})]
    if not named:
        raise InputError(f"{document.source} has texture {entry['index']} without a picture: export it again")
    number = named[0]
    image = document.entry("images", number)
    uri = image.get("uri", "")
    name = image.get("name") or ("" if uri.startswith("data:") else uri) or f"image {number}"
    sampler = document.entry("samplers", texture["sampler"]) if "sampler" in texture else {}
    moved = entry.get("extensions", {}).get(TRANSFORM, {})
    modes: dict[Any, str] = {CLAMP: "clamp", MIRROR: "mirror"}
    return Map(
        Picture(name, lambda: document.image(number)[0]),
        srgb,
        int(moved.get("texCoord", entry.get("texCoord", 0))),
        _matrix(moved),
        (modes.get(sampler.get("wrapS"), "repeat"), modes.get(sampler.get("wrapT"), "repeat")),
        sampler.get("magFilter") == NEAREST,
    )


def _matrix(moved: Mapping[str, Any]) -> Float64[np.ndarray, "2 3"]:
    """Translation times rotation times scale. Source: KHR_texture_transform."""
    angle = float(moved.get("rotation", 0))
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    return np.column_stack([turn * np.array(moved.get("scale", (1, 1)), float), moved.get("offset", (0, 0))])
