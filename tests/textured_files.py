"""Files with textures made of numbers, so that tests know every texel."""

import io
from pathlib import Path

import numpy as np
from gltf_files import Gltf


def png(texels) -> bytes:
    """A .png of whole numbers [H, W, 3 or 4] of 8 bits, or [H, W] of 16."""
    import PIL.Image

    stream = io.BytesIO()
    PIL.Image.fromarray(np.asarray(texels)).save(stream, "png")
    return stream.getvalue()


def flat(*colour: int) -> bytes:
    """A .png of one colour."""
    return png(np.full((2, 2, len(colour)), colour, np.uint8))


def noise(size: int, seed: int = 0) -> np.ndarray:
    """Texels that are black or white at random: the hardest to average."""
    return 255 * np.random.default_rng(seed).integers(0, 2, (size, size, 3), dtype=np.uint8)


def sheet(squares: int = 5, seed: int = 3):
    """A sheet of uneven triangles in the plane z = 0: positions, faces, and u, v that run with x and y."""
    x, y = np.meshgrid(np.linspace(0, 1, squares + 1), np.linspace(0, 1, squares + 1))
    inner = (np.minimum(x, 1 - x) > 0) & (np.minimum(y, 1 - y) > 0)
    shift = np.random.default_rng(seed).uniform(-0.3, 0.3, (2, *x.shape)) * inner / squares
    points = np.stack([x + shift[0], y + shift[1]], -1).reshape(-1, 2)
    corner = (np.arange(squares)[:, None] * (squares + 1) + np.arange(squares)).reshape(-1)
    a, b, c, d = corner, corner + 1, corner + squares + 2, corner + squares + 1
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return np.column_stack([points, np.zeros(len(points))]), faces, points


def gltf(materials, pictures=(), samplers=(), **tree) -> Gltf:
    """A file of these materials, and of a texture for every picture; without any mesh."""
    file = Gltf(nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}], materials=list(materials), **tree)
    if pictures:
        file.tree["images"] = [
            {"bufferView": file.view(content), "mimeType": "image/png", "name": f"picture {number}"}
            for number, content in enumerate(pictures)
        ]
        file.tree["samplers"] = list(samplers) or [{}]
        file.tree["textures"] = [{"source": number, "sampler": 0} for number in range(len(pictures))]
    return file


def save_sheet(path: Path, materials, pictures=(), samplers=(), squares: int = 5, **attributes) -> Path:
    """A .glb of the sheet in the first of `materials`, with `attributes` beside its positions."""
    positions, faces, uv = sheet(squares)
    file = gltf(materials, pictures, samplers)
    whole = {"TEXCOORD_0": uv, **attributes}
    primitive = file.primitive(faces.astype(np.uint32).ravel(), POSITION=positions, **whole)
    file.tree["meshes"] = [{"primitives": [{**primitive, "material": 0}]}]
    return file.save(path)


def textured(number: int = 0, **entry) -> dict:
    """A material whose base colour is texture `number`, with what else it has of metal and roughness."""
    return {"pbrMetallicRoughness": {"baseColorTexture": {"index": number}, "metallicFactor": 0, **entry}}
