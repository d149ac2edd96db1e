"""Light that differs from place to place of an object: captured at sample points, blended at every receiver."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh import Rotation
from torchprt.sh.precision import KeepsSingle, at_least_single, widened
from torchprt.shade.layer import LayerModule
from torchprt.shade.light_field import under_field
from torchprt.shade.shader import Shader, turned_light
from torchprt.transfer import Transfer


class LocalLightShader(KeepsSingle):
    """Exit radiance of every receiver under its own blend of K lights, `sum_k blend_vk light_k`.

    The same as the blend of the radiance under each of them, `sum_k blend_vk shader(light_k)_v`, for every layer and
    signal, and with many lights several times faster: the transfer is read once (`under_field`). The K lights are those
    of the sample points, or with gradients of every point its light and the derivatives of it along x, y and z, as
    `light.incident` and `transport.capture` give them. `blend [V, K]`, a buffer, or a parameter if `learn`: how they
    count; that of the transfer by `local_light_shader`.

    Laws: under K equal lights of weights that sum to 1 the radiance of the shader under one of them; linear in the
    lights; all else as `Shader`.
    Source: Sloan, Kautz and Snyder 2002, section 6.1.
    """

    single = ("blend",)
    blend: Tensor

    def __init__(self, shader: Shader, blend: Float[Tensor, "V K"], *, learn: bool = False):
        """Raises InputError unless there is a row a receiver and a column."""
        super().__init__()
        if blend.ndim != 2 or blend.shape[0] != shader.vertices or blend.shape[1] == 0:
            raise InputError(
                f"blend has shape {list(blend.shape)}: give the weights of every light at the {shader.vertices} "
                f"receivers, [{shader.vertices}, K]"
            )
        self.shader = shader
        held = blend.to(shader.turn.project.device, at_least_single(shader.dtype))
        if learn:
            self.blend = torch.nn.Parameter(held.detach().clone())
        else:
            self.register_buffer("blend", held)

    @property
    def order(self) -> int:
        """Number of SH bands of the lights."""
        return self.shader.order

    @property
    def turn(self) -> Rotation:
        """What turns the lights in a traced graph."""
        return self.shader.turn

    @property
    def vertices(self) -> int:
        """Number of receivers V."""
        return self.shader.vertices

    @property
    def lights(self) -> int:
        """Number of lights K."""
        return self.blend.shape[1]

    @property
    def needs(self) -> frozenset[str]:
        """What a call takes beside the lights, as of the shader."""
        return self.shader.needs

    @property
    def layers(self) -> Mapping[str, LayerModule]:
        """Those of the shader."""
        return self.shader.layers

    def forward(
        self,
        light: Float[Tensor, "*#B K N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
        frames: Float[Tensor, "*#B V 3 3"] | None = None,
        positions: Float[Tensor, "*#B V 3"] | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Radiance `[..., V, 3]` under the K lights of every entry of the batch; all else as for `Shader`.

        `rotation` turns what every sample point sees, about itself. An object that has turned is lit by the light that
        is captured at its sample points where they have gone, turned back: by the transpose of its own rotation.

        Raises InputError if there are not K lights, and as the shader.
        """
        if light.ndim < 3 or light.shape[-3] != self.lights:
            raise InputError(
                f"light has shape {list(light.shape)}: the blend is of {self.lights} lights, give [..., {self.lights}, "
                f"{self.order**2}, 3]"
            )
        turned = turned_light(light, None if rotation is None else rotation.unsqueeze(-3), self.shader.turn)
        field = self.field(widened(turned))
        return under_field(self.shader, field, eye=eye, view=view, frames=frames, positions=positions).to(light.dtype)

    def field(self, light: Float[Tensor, "*B K N 3"]) -> Float[Tensor, "*B V N 3"]:
        """The light that arrives at every receiver, where nothing hides it: the blend of the K lights."""
        # Receivers last in memory, as all that it is multiplied with.
        columns = light.flatten(-2).mT @ self.blend.T.to(light.dtype)
        return columns.unflatten(-2, light.shape[-2:]).movedim(-1, -3)


def local_light_shader(shader: Shader, transfer: Transfer) -> LocalLightShader:
    """The shader of a transfer with the blend that is stored with it. InputError if none is."""
    return LocalLightShader(shader, transfer.receivers.sampled()[1])
