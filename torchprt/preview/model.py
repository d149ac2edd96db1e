"""A lit model as a file: vertex colours that any viewer shows."""

from __future__ import annotations

import os

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.files import write
from torchprt.shade.display import TONE, ToneMap, check_tone, display, tone_mapped


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

    Raises InputError if `path` cannot be written.
    """
    import trimesh

    points = positions.detach().cpu().numpy()
    model: trimesh.Trimesh | trimesh.PointCloud
    if len(faces):
        model = trimesh.Trimesh(points, faces.cpu().numpy(), vertex_colors=colour.cpu().numpy(), process=False)
    else:
        model = trimesh.PointCloud(points, colors=np.asarray(colour.cpu()))
    content = model.export(file_type="ply")
    assert isinstance(content, bytes)
    write(path, content)
