"""A lit model as a file: vertex colours that any viewer shows."""

from __future__ import annotations

import os

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.files import write
from torchprt.shade.display import TONE, ToneMap, check_tone, display, tone_mapped

_VERTEX = np.dtype([("position", "<f4", 3), ("colour", "u1", 4)])
_TRIANGLE = np.dtype([("corners", "u1"), ("vertices", "<i4", 3)])


def tone_map(name: str) -> ToneMap:
    """`name` as a tone map; InputError if there is none of that name."""
    return check_tone(name)


def colours(radiance: Float[Tensor, "V 3"], exposure: float = 0.0, tone: str = TONE) -> Tensor:
    """8-bit sRGB of linear radiance, uint8 `[V, 3]`."""
    shown = display(radiance, exposure=exposure, tone=check_tone(tone))
    return (shown * 255).round().to(torch.uint8)


def linear_colours(radiance: Float[Tensor, "V 3"], exposure: float = 0.0, tone: str = TONE) -> Tensor:
    """Linear RGB in [0, 1], float32 `[V, 3]`, for formats that leave sRGB to the viewer: `colours` are its sRGB."""
    return tone_mapped(radiance.float(), exposure=exposure, tone=check_tone(tone))


def save_ply(positions: Float[Tensor, "V 3"], faces: Tensor, colour: Tensor, path: str | os.PathLike[str]) -> None:
    """Writes a binary PLY with sRGB vertex colours, vertices and faces in their order.

    The bytes are those of trimesh but for its comment; trimesh takes longer to load than all else that shading loads
    beside torch.

    Raises InputError if `path` cannot be written.
    """
    colour = colour.cpu()
    vertices = np.empty(len(positions), _VERTEX)
    vertices["position"], vertices["colour"][:, :3] = positions.detach().cpu().numpy(), colour[:, :3].numpy()
    vertices["colour"][:, 3] = 255
    triangles = np.empty(len(faces), _TRIANGLE)
    triangles["corners"], triangles["vertices"] = 3, faces.cpu().numpy()
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    header += [f"property float {axis}" for axis in "xyz"]
    header += [f"property uchar {channel}" for channel in ("red", "green", "blue", "alpha")]
    if len(triangles):
        header += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    header += ["end_header", ""]
    write(path, "\n".join(header).encode("ascii") + vertices.tobytes() + triangles.tobytes())
