"""A shader with its light fixed: less to compute when only the eye changes."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.shade.layer import LayerModule


class FixedLightShader(nn.Module):
    """Exit radiance under fixed lights; made by `Shader.fix_light`, whose layers it keeps.

    Buffers: for every layer that depends on the eye `NAME_coefficients [*B, 3, M, G]`, what its rows send times its
    weight; `radiance [*B, 3, V]`, that of all other layers, None if there is none.
    """

    radiance: Tensor | None

    def __init__(
        self,
        layers: Mapping[str, LayerModule],
        coefficients: Mapping[str, Tensor],
        radiance: Tensor | None,
        vertices: int,
        order: int,
    ):
        super().__init__()
        self.layers: Mapping[str, LayerModule] = nn.ModuleDict(layers)  # type: ignore[assignment]
        self.vertices, self.order = vertices, order
        self.needs = frozenset({"eye"})
        for name, value in coefficients.items():
            self.register_buffer(f"{name}_coefficients", value)
        self.register_buffer("radiance", radiance)

    def forward(
        self, *, eye: Float[Tensor, "*#B 3"] | None = None, view: Float[Tensor, "*#B 3"] | None = None
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance of every receiver; the batch of `eye` or `view` broadcasts with that of the lights.

        Raises InputError as the shader that made it.
        """
        radiance = self.radiance
        for name, layer in self.layers.items():
            values = layer.values(eye, view)
            assert values is not None
            coefficients: Tensor = getattr(self, f"{name}_coefficients")
            radiance = layer.spread(weighted(coefficients, values), radiance, self.vertices)
        assert radiance is not None
        return radiance.mT


def weighted(coefficients: Float[Tensor, "*#B 3 M G"], values: Float[Tensor, "*#B G M"]) -> Float[Tensor, "... 3 G"]:
    """`sum_i values_i coefficients_i`, one function of the eye after the other: all products at once would be as large
    as the coefficients."""
    (first, weight), *others = zip(values.unsqueeze(-3).unbind(-1), coefficients.unbind(-2), strict=True)
    radiance = first * weight
    for value, weight in others:
        radiance = torch.addcmul(radiance, value, weight)
    return radiance
