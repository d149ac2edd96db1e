"""Pictures of a patch on a surface, read at every hit of the camera's rays instead of at vertices."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.pose import surface_frames
from torchprt.pose.surface_frames import corner_uv
from torchprt.preview.camera import Camera
from torchprt.preview.environment import Environment
from torchprt.preview.picture import Still
from torchprt.preview.turntable import Studio
from torchprt.shade import PatchShader, shader
from torchprt.transfer import Dense, Diffuse, Transfer, Vertices

# Numbers of transfer vectors that are held at a time.
_NUMBERS = 1 << 23


class PatchStudio(Studio):
    """A studio of a surface covered with a patch, which is read and shaded at every sample of every pixel: what is
    finer than the faces of the surface is there, and charts may begin anew at any edge.

    `positions`, `faces`, `uv`, `normals` and `repeat` are those of `shade.lay`. Texture coordinates of the corners of a
    face, places and frames are interpolated over it, and frames are made orthonormal again. `brdf` as in `shader`; all
    other `options` are those of a `Studio`.
    Source: Sloan, Luna and Snyder 2005, section 6.
    """

    def __init__(
        self,
        patch: Transfer,
        positions: Float[Tensor, "V 3"],
        faces: Int[Tensor, "F 3"],
        uv: Float[Tensor, "..."] | None,
        environment: Environment,
        *,
        repeat: tuple[float, float] = (1.0, 1.0),
        normals: Float[Tensor, "V 3"] | None = None,
        brdf: Any = None,
        **options: Any,
    ):
        self.patch = PatchShader(patch, brdf=brdf)
        corners = corner_uv(faces, uv, len(positions)).double()
        self._uv = corners * corners.new_tensor(repeat)
        self._frames = surface_frames(positions, faces, uv, normals).double()
        # What cameras frame and rays meet; nothing is shaded at its vertices.
        place = Vertices(positions=positions, normals=self._frames[..., 2].float(), faces=faces)
        nothing = Diffuse(albedo=torch.zeros(1, 1), signal=Dense(values=torch.zeros(1, 1, len(positions))))
        surface = Transfer(receivers=place, layers={"diffuse": nothing})
        super().__init__(surface, shader(surface), environment, **options)
        self._points: tuple[Still, Tensor, Tensor, Tensor] | None = None

    def shaded(self, camera: Camera, light: Float[Tensor, "N 3"]) -> tuple[Still, Float[Tensor, "E 3"]]:
        still = self._look(camera)
        if self._points is None or self._points[0] is not still:
            self._points = (still, *self._at_hits(still))
        _, uv, frames, places = self._points
        eye = torch.tensor(still.camera.eye, dtype=torch.float64)
        dtype = self.patch.shader.turn.project.dtype
        seen = {"eye": eye} if "eye" in self.patch.needs else {}
        found = [light.new_zeros(0, 3).float()]
        for some in torch.arange(len(uv)).split(max(1, _NUMBERS // len(light))):
            radiance = self.patch(light.to(dtype), uv[some], frames[some], positions=places[some], **seen)
            found.append(radiance.float())
        return still.of_hits(), torch.cat(found)

    def _at_hits(self, still: Still) -> tuple[Tensor, Tensor, Tensor]:
        """Texture coordinates, frames and places of the hits."""
        triangle, weights = still.hits
        weights = weights.double()
        corners = self.transfer.faces.long()[triangle]
        uv = (self._uv[triangle] * weights[..., None]).sum(1)
        places = (self.transfer.positions.double()[corners] * weights[..., None]).sum(1)
        mean = (self._frames[corners] * weights[..., None, None]).sum(1)
        up = normalize(mean[..., 2], dim=-1)
        along = normalize(mean[..., 0] - (mean[..., 0] * up).sum(-1, keepdim=True) * up, dim=-1)
        across = torch.linalg.cross(up, along, dim=-1)
        hand = torch.where((across * mean[..., 1]).sum(-1, keepdim=True) < 0, -1.0, 1.0)
        return uv, torch.stack([along, hand * across, up], -1), places
