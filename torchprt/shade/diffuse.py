"""Diffuse exit radiance: one product of light and transfer vectors."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.sh import Rotation, rotate
from torchprt.transfer import DiffuseTransfer


class DiffuseShader(nn.Module):
    """Exit radiance of diffuse receivers, `albedo * transfer . D(rotation) light`.

    Made by `torchprt.shader(transfer)`. Buffers: `transfer [C, N, V]`, `albedo [V or 1, 3 or 1]`; either is a
    parameter instead when it is named in `learn`. Without bounces the albedo may be changed or learned freely;
    with them it was also baked into what other surfaces receive, so learning it is refused.

    Laws: linear in `light`; turning the light and asking for `rotation` are the same; channels do not mix.
    Half-precision transfer is widened to float32 when the shader is made; otherwise buffers share the memory of the
    transfer, so what is written into one is written into both. Parameters are copies.
    Source: Sloan, Kautz and Snyder 2002, section 6, equation 8.
    """

    transfer: Tensor
    albedo: Tensor

    def __init__(self, transfer: DiffuseTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()):
        super().__init__()
        learn = (learn,) if isinstance(learn, str) else tuple(learn)
        unknown = sorted(set(learn) - {"albedo", "transfer"})
        if unknown:
            raise InputError(f"learn names '{unknown[0]}': a diffuse shader can learn 'albedo' and 'transfer'")
        if "albedo" in learn and transfer.bounces > 0:
            raise InputError(
                f"albedo cannot be learned: {transfer.bounces} bounces are baked with it into what other surfaces "
                "receive; bake without bounces"
            )
        if dtype is None:
            dtype = torch.promote_types(transfer.transfer.dtype, torch.float32)
        for name in ("transfer", "albedo"):
            value = getattr(transfer, name).detach().to(dtype)
            if name in learn:
                self.register_parameter(name, nn.Parameter(value.clone()))
            else:
                self.register_buffer(name, value)
        self.turn = Rotation(transfer.order, dtype).to(transfer.transfer.device)
        self.order = transfer.order

    def extra_repr(self) -> str:
        channels, _, vertices = self.transfer.shape
        return f"order={self.order}, channels={channels}, vertices={vertices}"

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        out: Tensor | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance of every receiver under every light.

        `light [..., N, 3]`; `rotation [..., 3, 3]` turns the environment (identity if omitted), its batch
        broadcasts with that of the light. The result is a view with vertices contiguous, not a permuted copy.
        `out`: a former result to write over, for loops that must not allocate; no gradients then.

        Raises InputError if the light is not of the order of the transfer, or, outside a traced graph, if
        `rotation` is not a proper rotation within 1e-4.
        """
        light = turned_light(light, rotation, self.turn)
        albedo = self.albedo
        if albedo.shape[0] == 1:
            # One albedo for all receivers: applied to N numbers instead of V.
            light = light * albedo
        radiance = self._product(light.movedim(-1, -2), out)
        if albedo.shape[0] != 1:
            radiance = radiance * albedo.T if out is None else radiance.mul_(albedo.T)
        return radiance.movedim(-1, -2)

    def _product(self, light: Tensor, out: Tensor | None) -> Tensor:
        """`[*B, 3, N]` to `[*B, 3, V]` as one matrix product (one a channel if the transfer is coloured)."""
        channels, count, vertices = self.transfer.shape
        batch = light.shape[:-2]
        if channels == 1:
            target = None if out is None else self._target(out, out.movedim(-1, -2), (*batch, 3, vertices))
            flat = light.reshape(math.prod(batch) * 3, count)
            return torch.mm(flat, self.transfer[0], out=target).view(*batch, 3, vertices)
        # Every channel has its own transfer: channels come first, in the light and in the memory of the result.
        target = None if out is None else self._target(out, out.movedim(-1, 0), (3, *batch, vertices))
        if target is not None:
            target = target.view(3, math.prod(batch), vertices)
        flat = light.movedim(-2, 0).reshape(3, math.prod(batch), count)
        return torch.bmm(flat, self.transfer, out=target).view(3, *batch, vertices).movedim(0, -2)

    def _target(self, out: Tensor, memory: Tensor, shape: tuple[int, ...]) -> Tensor:
        """`memory`, the view of `out` that is contiguous, as rows of vertices; InputError if it is not."""
        if memory.shape != shape or not memory.is_contiguous():
            raise InputError(
                f"out must be a former result for this batch of lights and {shape[-1]} vertices: "
                f"it has shape {tuple(out.shape)} and strides {out.stride()}"
            )
        return memory.view(math.prod(shape[:-1]), shape[-1])


def turned_light(light: Tensor, rotation: Tensor | None, turn: Rotation) -> Tensor:
    """`light [*B, N, 3]` as a shader uses it: turned if asked to, InputError if it is not of the order of `turn`."""
    if light.shape[-2] != turn.order**2:
        raise InputError(
            f"light has {light.shape[-2]} coefficients but the transfer is of order {turn.order}: "
            f"project the light with order={turn.order}"
        )
    if rotation is None:
        return light
    # A graph takes its constants from the module; elsewhere the rotation is checked and the fast way taken.
    return turn(light, rotation) if torch.compiler.is_compiling() else rotate(light, rotation)
