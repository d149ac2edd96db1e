"""A map of texels in a page: where its receivers are on it, and where the corners of its meshes are."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.files import write
from torchprt.transfer.atlas import Atlas

MAP = "map.bin.gz"


def mapped_corners(atlas: Atlas) -> tuple[Int[Tensor, "P"], Float[Tensor, "P 2"], Int[Tensor, "F 3"]]:
    """The meshes of an atlas with a vertex for every vertex and place on the map: which it was, where, and the faces.

    A face without texture coordinates is at (0, 0)."""
    _, _, faces = atlas.surface
    rows = torch.cat([faces.long()[..., None].double(), atlas.mesh_uv.nan_to_num(0.0).double()], -1).flatten(0, 1)
    unique, number = torch.unique(rows, dim=0, return_inverse=True)
    return unique[:, 0].long(), unique[:, 1:], number.reshape(-1, 3)


def save_map(atlas: Atlas, albedo: Float[Tensor, "V 3"], uv: Float[Tensor, "P 2"], folder: Path) -> dict[str, Any]:
    """Writes `map.bin.gz`, and says what the page must know of it: little-endian, int32 the texel of every receiver,
    that of every gutter and its four sources, then float32 the weights of these, normals and albedo of every receiver,
    and where every vertex of `mesh.glb` is."""
    whole = (atlas.texel, atlas.gutter, atlas.gutter_sources)
    parts = (atlas.gutter_weights, atlas.normals, albedo.expand(atlas.count, 3), uv)
    content = [part.detach().cpu().to(torch.int32).numpy().astype("<i4").tobytes() for part in whole]
    content += [part.detach().cpu().float().contiguous().numpy().astype("<f4").tobytes() for part in parts]
    write(folder / MAP, gzip.compress(b"".join(content), 6, mtime=0))
    return {"rows": atlas.rows, "columns": atlas.columns, "count": atlas.count, "gutter": len(atlas.gutter)}
