"""Shaders with an eye or a light fixed: less to compute when only the other changes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.sh import Rotation
from torchprt.shade.diffuse import DiffuseShader

if TYPE_CHECKING:
    from torchprt.shade.view import ViewShader


class FixedEyeShader(DiffuseShader):
    """Exit radiance toward one eye, `transfer . D(rotation) light`; made by the method `fix_eye` of a shader.

    A `DiffuseShader` in everything, with all layers and their weights in `transfer [C, N, V]` and an albedo of 1.
    """

    def __init__(self, vectors: Float[Tensor, "C N V"], turn: Rotation):
        nn.Module.__init__(self)
        self.register_buffer("transfer", vectors.contiguous())
        self.register_buffer("albedo", vectors.new_ones(1, 1))
        self.turn = turn
        self.order = turn.order


class FixedLightShader(nn.Module):
    """Exit radiance under fixed lights; made by the method `fix_light` of a shader, which it keeps.

    Buffers: `coefficients [*B, 3, M, G]`, exit coefficients times specular; `radiance [*B, 3, V]` of the diffuse layer,
    None if there is none.
    """

    coefficients: Tensor
    radiance: Tensor | None

    def __init__(self, shader: ViewShader, coefficients: Tensor, radiance: Tensor | None):
        super().__init__()
        self.shader = shader
        self.register_buffer("coefficients", coefficients)
        self.register_buffer("radiance", radiance)

    def forward(
        self, *, eye: Float[Tensor, "*#B 3"] | None = None, view: Float[Tensor, "*#B 3"] | None = None
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance of every receiver; the batch of `eye` or `view` broadcasts with that of the lights.

        Raises InputError as the shader that made it.
        """
        values = self.shader.values(eye, view).unsqueeze(-3)
        # One exit function after the other: all products at once would be as large as the coefficients.
        (first, weight), *others = zip(values.unbind(-1), self.coefficients.unbind(-2), strict=True)
        scattered = first * weight
        for value, weight in others:
            scattered = torch.addcmul(scattered, value, weight)
        return self.shader.spread(scattered, self.radiance).mT
