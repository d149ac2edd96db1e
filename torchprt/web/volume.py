"""A volume in a page: which cells hold what, beside the graph of what they send."""

from __future__ import annotations

import gzip
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from torchprt.files import write
from torchprt.shade import Composite
from torchprt.transfer import Cells

NAME = "volume.bin.gz"


def save_volume(cells: Cells, folder: Path) -> dict[str, Any]:
    """Writes `volume.bin.gz`: of every cell that holds anything its number in the box of `shape`, int32, then the
    extinction of each, float32; and says what the page must know of them.

    The box is that of these cells with an empty one around, so that between them and nothing it is read smoothly.
    `corner`: its lowest, in the world; `steps`: a ray's.
    """
    reading = Composite(cells, reading="trilinear")
    places = cells.places().long()
    first = places.amin(0) - 1
    shape = (places.amax(0) - first + 2).tolist()
    where = places - first
    number = ((where[:, 0] * shape[1] + where[:, 1]) * shape[2] + where[:, 2]).int().cpu().numpy()
    extinction = cells.extinction.float().cpu().numpy()
    content = number.astype("<i4").tobytes() + extinction.astype("<f4").tobytes()
    write(folder / NAME, gzip.compress(content, 6, mtime=0))
    corner = [low + step * int(at) for low, step, at in zip(cells.origin, cells.spacing, first, strict=True)]
    return {"shape": shape, "corner": corner, "spacing": list(cells.spacing), "steps": reading.samples}


def box(cells: Cells) -> tuple[Float[Tensor, "8 3"], Float[Tensor, "8 3"], Int[Tensor, "12 3"]]:
    """Corners, normals and faces of the box in which anything is seen: half a cell beyond those that hold anything."""
    subject = cells.subject.double()
    half = torch.tensor(cells.spacing, dtype=torch.float64) / 2
    low, high = subject.amin(0) - half, subject.amax(0) + half
    signs = torch.cartesian_prod(*[torch.tensor([0.0, 1.0], dtype=torch.float64)] * 3)
    # Corner number 4 x + 2 y + z; counter-clockwise from outside.
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))]
    normals = (2 * signs - 1) / math.sqrt(3)
    return (low + signs * (high - low)).float(), normals.float(), torch.from_numpy(np.array(faces, np.int32))
