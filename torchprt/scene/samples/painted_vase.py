"""A painted vase: a model with texture coordinates, a picture on it and a second material."""

import io
import math
import os

import numpy as np
import torch
from jaxtyping import Bool, Float32, UInt8

from torchprt.brdf import GGX
from torchprt.errors import InputError
from torchprt.files import write

from ..glosses import Glosses
from ..material import Material
from ..mesh import Mesh, make_mesh
from ..object import Object
from ..scene import Scene
from ..surface import texture_albedo
from .lathe import lathe, smooth_profile
from .vase import PROFILE

PORCELAIN, COBALT, CORAL = (236, 231, 219), (32, 58, 132), (196, 84, 58)
"""sRGB."""

GOLD = (1.0, 0.766, 0.336)
"""Linear, of the metal."""

FOOT, BELLY, LIP, INSIDE = 0.078, 0.25, 0.492, 0.56
"""Along the profile: where the gold of the foot ends, the middle of the painting, where the gold of the lip begins and
ends."""


AROUND = 0.85
"""How far the belly is around, in units of v: what keeps motifs in shape."""


def painted_vase(resolution: int = 128, polished: bool = False) -> Scene:
    """The shape of `vase`, of porcelain painted in cobalt and coral, its foot and lip gilded.

    2 `resolution` columns around, and rows of the same size on its outside. The colours of its vertices are means of
    `vase_picture` over the surface around each. `write_painted_vase` writes it as a .glb of two materials. The gold is
    diffuse, or if `polished` of a glossy metal, which the porcelain is not.

    Raises InputError if `resolution` is below 16.
    """
    mesh = _mesh(resolution)
    albedo = texture_albedo(mesh, vase_picture())
    gold = np.zeros(len(mesh.positions), dtype=bool)
    gold[mesh.faces.numpy()[gilded(mesh)]] = True
    if not polished:
        albedo[gold] = albedo.new_tensor(GOLD)
        return Scene([Object(mesh, Material(albedo))])
    albedo[gold] = 0.0
    weight = torch.ones_like(albedo)
    weight[gold] = weight.new_tensor(GOLD)
    polish = Glosses((GGX(0.2),), torch.from_numpy(gold.astype(np.int64) - 1))
    return Scene([Object(mesh, Material(albedo, gloss=polish, specular=weight))])


def _mesh(resolution: int) -> Mesh:
    if resolution < 16:
        raise InputError(f"resolution is {resolution}: give at least 16")
    rows = 3 * resolution
    # A third of the rows inside, where nothing is painted.
    kept = np.unique(np.append([row for row in range(rows) if row < INSIDE * rows or row % 3 == 0], rows))
    positions, faces, uv = lathe(smooth_profile(PROFILE, rows)[kept], 2 * resolution)
    uv[..., 1] = np.interp(uv[..., 1], np.linspace(0, 1, len(kept)), kept / rows)
    return make_mesh(positions, faces, name="painted vase", uv=uv)


def gilded(mesh: Mesh) -> Bool[np.ndarray, "F"]:
    """Which faces of the vase are of gold."""
    assert mesh.uv is not None
    along = mesh.uv.numpy()[..., 1].mean(axis=1)
    return (along < FOOT) | ((along > LIP) & (along < INSIDE))


def write_painted_vase(path: str | os.PathLike[str], resolution: int = 128) -> None:
    """Writes the vase as a .glb: "porcelain" with a texture of sRGB, and the metal "gold".

    Raises InputError if `resolution` is below 16, or if the file cannot be written.
    """
    import PIL.Image
    import trimesh
    from trimesh.visual import TextureVisuals
    from trimesh.visual.material import PBRMaterial

    if os.path.splitext(path)[1].lower() != ".glb":
        raise InputError(f"{os.fspath(path)} must end in .glb")
    mesh = _mesh(resolution)
    assert mesh.uv is not None
    faces, uv, normals = mesh.faces.numpy(), mesh.uv.numpy(), mesh.normals.numpy()
    picture = PIL.Image.open(io.BytesIO(_png(vase_picture())))
    porcelain = PBRMaterial("porcelain", baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=0.4)
    gold = PBRMaterial("gold", baseColorFactor=[*GOLD, 1.0], metallicFactor=1.0, roughnessFactor=0.45)
    scene = trimesh.Scene()
    metal = gilded(mesh)
    for material, mine in ((porcelain, ~metal), (gold, metal)):
        # A vertex for every pair of a position and texture coordinates.
        corners = np.column_stack([faces[mine].ravel(), uv[mine].reshape(-1, 2)])
        unique, place = np.unique(corners, axis=0, return_inverse=True)
        vertex = unique[:, 0].astype(np.int64)
        # The library has v run up, and turns it for the file: the picture's row 0 is at v = 0 here.
        visual = TextureVisuals(np.column_stack([unique[:, 1], 1 - unique[:, 2]]), material=material)
        piece = trimesh.Trimesh(
            mesh.positions.numpy()[vertex],
            place.reshape(-1, 3),
            vertex_normals=normals[vertex],
            visual=visual,
            process=False,
        )
        scene.add_geometry(piece, geom_name=material.name)
    write(path, scene.export(file_type="glb", include_normals=True))


def _png(texels: UInt8[np.ndarray, "H W 3"]) -> bytes:
    import PIL.Image

    stream = io.BytesIO()
    PIL.Image.fromarray(texels).save(stream, "png")
    return stream.getvalue()


def vase_picture(size: int = 1024) -> UInt8[np.ndarray, "size size 3"]:
    """The picture on the vase, sRGB: row 0 at v = 0, and its first column continues its last. `size` is even.

    Petals above the foot, a wave of leaves around the belly, a border of lozenges below the neck.
    """
    picture = np.full((size, size, 3), PORCELAIN, np.uint8)
    # The painting ends below the lip, and every motif is there an even number of times.
    rows, columns = math.ceil(size * LIP), math.ceil(size / 2)
    middles = (np.arange(size, dtype=np.float32) + 0.5) / size
    v, u = np.meshgrid(middles[:rows], middles[:columns], indexing="ij")
    colours = np.full((rows, columns, 3), PORCELAIN, np.float32)
    for pattern, colour in ((_cobalt, COBALT), (_coral, CORAL)):
        # Edges are a texel and a half wide, so that the picture has none that are harder than it can hold.
        ink = np.clip(0.5 - pattern(u, v) * (size / 1.5), 0, 1)
        colours += ink[..., None] * (np.array(colour, np.float32) - colours)
    half = np.round(colours).astype(np.uint8)
    picture[:rows] = np.concatenate([half, half], axis=1)[:, :size]
    return picture


def _cobalt(u: Float32[np.ndarray, "H W"], v: Float32[np.ndarray, "H W"]) -> Float32[np.ndarray, "H W"]:
    """About the distance to what is blue, in units of v, negative inside."""
    parts = [_line(v, at, half) for at, half in ((0.086, 0.005), (0.163, 0.0035), (0.331, 0.0035), (0.404, 0.005))]
    # Petals: arches whose width falls with height.
    across = np.abs(_cell(u, 16))
    height = (v - 0.091) / 0.064
    arch = 0.46 * np.sqrt(np.clip(1 - height**2, 0, 1))
    inner = 0.29 * np.sqrt(np.clip(1 - (height / 0.74) ** 2, 0, 1))
    ring = np.maximum(across - arch, inner - across) * (AROUND / 16)
    parts.append(np.where((height > 0) & (height < 1), ring, 0.02))
    # A wave around the belly, and leaves that grow from it, up and down in turn.
    middle = BELLY + 0.024 * np.sin(2 * np.pi * 6 * u)
    slope = 0.024 * 2 * np.pi * 6 / AROUND * np.cos(2 * np.pi * 6 * u)
    parts.append(np.abs(v - middle) / np.sqrt(1 + slope**2) - 0.0045)
    for phase, side in ((0.25, -1), (0.75, 1)):
        x, y = _cell(u - (phase - 0.5) / 6, 6) * (AROUND / 6), (v - BELLY) * side
        for lean in (-1, 1):
            parts.append(_leaf(x - lean * 0.03, y - 0.002, lean * 0.8, 0.036, 0.0125))
        parts.append(_leaf(x, y - 0.012, 0.0, 0.036, 0.0115))
    # Lozenges of the border, hollow.
    x, y = np.abs(_cell(u, 20)) * (AROUND / 20), np.abs(v - 0.3675)
    parts.append(np.abs((x / 0.0195 + y / 0.0285 - 1) * 0.016) - 0.0036)
    # Drops on the neck, which is half as wide.
    parts.append(_leaf(_cell(u, 12) * (0.4 / 12), v - 0.449, 0.0, 0.03, 0.0095))
    return np.minimum.reduce(parts)


def _coral(u: Float32[np.ndarray, "H W"], v: Float32[np.ndarray, "H W"]) -> Float32[np.ndarray, "H W"]:
    """The same for what is red: berries, lines, and the middles of petals and lozenges."""
    parts = []
    for phase, side in ((0.25, 1), (0.75, -1)):
        x, y = _cell(u - (phase - 0.5) / 6, 6) * (AROUND / 6), (v - BELLY) * side
        for dx, dy in ((0.0, 0.056), (-0.024, 0.048), (0.024, 0.048)):
            parts.append(np.hypot(x - dx, y - dy) - 0.0095)
    x, y = _cell(u, 20) * (AROUND / 20), v - 0.3675
    parts.append(np.hypot(x / 0.8, y) - 0.0095)
    parts.append(_leaf(_cell(u, 16) * (AROUND / 16), v - 0.112, 0.0, 0.018, 0.0085))
    parts += [_line(v, 0.4165, 0.0035), _line(v, 0.1755, 0.0035)]
    return np.minimum.reduce(parts)


def _cell(u: Float32[np.ndarray, "H W"], count: int) -> Float32[np.ndarray, "H W"]:
    """Where u is in its one of `count` cells around, from -1/2 to 1/2."""
    return np.mod(u * count, 1.0) - 0.5


def _line(v: Float32[np.ndarray, "H W"], at: float, half: float) -> Float32[np.ndarray, "H W"]:
    return np.abs(v - at) - half


def _leaf(
    x: Float32[np.ndarray, "H W"], y: Float32[np.ndarray, "H W"], lean: float, length: float, width: float
) -> Float32[np.ndarray, "H W"]:
    """A pointed leaf around the origin, `length` and `width` half its extents, leaning to the right."""
    cosine, sine = math.cos(lean), math.sin(lean)
    along, across = x * sine + y * cosine, x * cosine - y * sine
    return np.abs(across) - width * (1 - np.clip((along / length) ** 2, 0, 4))
