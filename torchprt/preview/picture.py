"""Still pictures without a display: Embree casts the camera's rays."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.preview.camera import Camera, frame
from torchprt.shade import display
from torchprt.shade.display import ToneMap
from torchprt.trace import Tracer

BACKGROUND = 0.06


class Still:
    """A model seen by a camera: the hits are found once, then every light and rotation is an interpolation.

    `positions [V, 3]`, `faces [F, 3]`; `size` in pixels (width, height); `samples` rays a pixel along each side.
    The camera of `frame` if none is given. Back faces are black: they reflect nothing. `opacity [V]` in [0, 1]: how
    much the surface covers of the background, 1 if it is not given (`preview.opacity` makes it for a ground).
    Raises InputError if the model has no faces or the picture no pixels.
    """

    def __init__(
        self,
        positions: Float[Tensor, "V 3"],
        faces: Tensor,
        *,
        size: tuple[int, int] = (800, 600),
        camera: Camera | None = None,
        samples: int = 2,
        opacity: Float[Tensor, "V"] | None = None,
    ):
        if len(faces) == 0:
            raise InputError("a picture needs faces, this transfer was recorded at loose points: write .npy or .ply")
        width, height = size
        if width < 1 or height < 1 or samples < 1:
            raise InputError(f"size {width}x{height} with {samples} samples has no pixels: give numbers from 1")
        self.camera = camera or frame(positions, aspect=width / height)
        self._rays = width * samples, height * samples
        tracer = Tracer(positions, faces)
        eye = torch.tensor(self.camera.eye, dtype=torch.float64)
        hits = tracer.camera(eye, self.directions())
        self._seen = hits.triangle >= 0
        triangle = hits.triangle.long().clamp(min=0)
        corners, front = faces.long()[triangle], hits.front
        if bool((self._seen & ~front).any()):
            # A two-sided surface is there twice, and Embree may have met either: the side that faces us counts.
            reverse = reverse_corners(positions, faces)[triangle]
            twin = ~front & (reverse[..., 0] >= 0)
            corners, front = torch.where(twin[..., None], reverse, corners), front | twin
        weights = torch.stack([1 - hits.u - hits.v, hits.u, hits.v], -1)
        self._vertices = len(positions)
        self._corners = corners
        covers = 1.0 if opacity is None else (weights * opacity[corners]).sum(-1).to(torch.float32)
        self._covered = torch.where(self._seen, covers, 0.0)[..., None]
        self._weights = torch.where((self._seen & front)[..., None], weights, 0)
        self._samples = samples

    def directions(self) -> Float[Tensor, "h w 3"]:
        """The world direction of every ray, `samples` times as many along each side as there are pixels."""
        return self.camera.directions(*self._rays)

    def radiance(
        self, vertex_radiance: Float[Tensor, "V 3"], background: float | Float[Tensor, "h w 3"] = BACKGROUND
    ) -> Float[Tensor, "H W 3"]:
        """The picture of linear radiance. `background`: one for all rays that meet nothing, or that of `directions`.

        Raises InputError unless there is a radiance for every vertex.
        """
        if len(vertex_radiance) != self._vertices:
            raise InputError(
                f"radiance of {len(vertex_radiance)} vertices for a model of {self._vertices}: give each one"
            )
        shaded = (vertex_radiance[self._corners] * self._weights[..., None].to(vertex_radiance)).sum(-2)
        covered = self._covered.to(shaded)
        picture = covered * shaded + (1 - covered) * background
        height, width = picture.shape[0] // self._samples, picture.shape[1] // self._samples
        return picture.view(height, self._samples, width, self._samples, 3).mean((1, 3))

    def picture(
        self,
        vertex_radiance: Float[Tensor, "V 3"],
        *,
        exposure: float = 0.0,
        tone: ToneMap = "filmic",
        background: float | Float[Tensor, "h w 3"] = BACKGROUND,
    ) -> Float[Tensor, "H W 3"]:
        """The picture as sRGB in [0, 1]; a background of one number is not exposed."""
        scale = 2.0**exposure
        behind = background * scale if isinstance(background, Tensor) else background
        return display(self.radiance(vertex_radiance * scale, behind), tone=tone)


def reverse_corners(positions: Tensor, faces: Tensor) -> Tensor:
    """`[F, 3]`: for each corner of a face the vertex at its place of the face's other side; -1 where there is none."""
    _, place = torch.unique(positions, dim=0, return_inverse=True)
    places, by_place = place[faces.long()].sort(-1)
    _, group = torch.unique(places, dim=0, return_inverse=True)
    # Faces over the same places show opposite sides if their corners run round them in opposite senses.
    key = 2 * group + ((by_place[:, 1] - by_place[:, 0]) % 3 == 1)
    face_of = torch.full((2 * len(faces),), -1).scatter_reduce(0, key, torch.arange(len(faces)), "amax")
    twin = face_of[key ^ 1]
    sorted_vertices = faces.long().gather(1, by_place)
    reverse = sorted_vertices[twin.clamp(min=0)].gather(1, by_place.argsort(-1))
    return torch.where(twin[:, None] >= 0, reverse, -1)


def save_png(picture: Float[Tensor, "H W 3"], path: str | os.PathLike[str]) -> None:
    """Writes sRGB values in [0, 1] as 8-bit PNG. Raises InputError if `path` cannot be written."""
    from PIL import Image

    values = (picture.detach().cpu().clamp(0, 1) * 255).round().to(torch.uint8).numpy()
    with atomic(Path(path)) as temporary:
        Image.fromarray(np.ascontiguousarray(values)).save(temporary, format="PNG")
