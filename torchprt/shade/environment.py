"""The whole run time as one module: environment -> light -> rotation -> shading -> display."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import linear

from torchprt.errors import InputError
from torchprt.sh import cube_basis
from torchprt.sh.precision import KeepsSingle, without_autocast
from torchprt.shade.display import ToneMap, display
from torchprt.shade.local_light import LocalLightShader
from torchprt.shade.shader import Shader


class EnvironmentShader(KeepsSingle):
    """Shades straight from cube maps: `environment [..., 6, H, W, 3]` -> light -> rotation -> exit radiance.

    Of a `LocalLightShader` there are K cube maps, one a light: `environment [..., K, 6, H, W, 3]`.
    `size`: H = W of the cube maps. With `tone` the result is an sRGB picture value (exposure in stops, tone map,
    sRGB), otherwise linear radiance. Gradients flow to the environment, and to the eye if the shader takes one.
    Source: Sloan, Kautz and Snyder 2002, figure 2 and section 6.2.
    """

    single = ("weights",)
    weights: Tensor

    def __init__(
        self, shader: Shader | LocalLightShader, size: int, *, exposure: float = 0.0, tone: ToneMap | None = None
    ):
        super().__init__()
        if size < 2:
            raise InputError(f"size {size} of the cube map is too small: give at least 2")
        self.shader = shader
        self.size = size
        self.exposure = exposure
        self.tone: ToneMap | None = tone
        with torch.device("cpu"):
            table = cube_basis(shader.order, size, dtype=shader.turn.project.dtype)
        table = table.to(shader.turn.project.device)
        self.register_buffer("weights", table, persistent=False)

    def forward(
        self,
        environment: Float[Tensor, "*#B 6 H W 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
        frames: Float[Tensor, "*#B V 3 3"] | None = None,
        positions: Float[Tensor, "*#B V 3"] | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Radiance `[..., V, 3]`; `eye` or `view`, `frames` or `positions` go to a shader that depends on them.

        Raises InputError if the cube map is not of the stated size, or the shader does not depend on what is given.
        """
        if environment.shape[-3:-1] != (self.size, self.size):
            raise InputError(
                f"environment has faces of {tuple(environment.shape[-3:-1])} texels but the graph was made for "
                f"{self.size} x {self.size}: resize it or make another graph"
            )
        # `sh.project_cube` with the table in a buffer, so that the graph can be compiled and exported.
        texels = environment.movedim(-1, -4).reshape(*environment.shape[:-4], 3, 6 * self.size**2)
        light = _projected(texels, self.weights)
        radiance = self.shader(light, rotation, eye=eye, view=view, frames=frames, positions=positions)
        return radiance if self.tone is None else display(radiance, exposure=self.exposure, tone=self.tone)


@without_autocast
def _projected(texels: Float[Tensor, "*B 3 texels"], table: Float[Tensor, "N texels"]) -> Float[Tensor, "*B N 3"]:
    return linear(texels.to(table.dtype), table).mT.to(texels.dtype)
