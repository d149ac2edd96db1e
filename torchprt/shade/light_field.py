"""Shading under a light that differs from receiver to receiver."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.shade.shader import Shader


def under_field(
    shader: Shader,
    field: Float[Tensor, "*#B V N 3"],
    *,
    eye: Float[Tensor, "*#B 3"] | None = None,
    view: Float[Tensor, "*#B 3"] | None = None,
    frames: Float[Tensor, "*#B V 3 3"] | None = None,
    positions: Float[Tensor, "*#B V 3"] | None = None,
) -> Float[Tensor, "... V 3"]:
    """Linear exit radiance of every receiver of `shader`, each under a light of its own, `[..., V, 3]`.

    `field [..., V, N, 3]`: the SH coefficients, in the world, of the light that arrives at each receiver: of what casts
    shadows on it (`NeighbourhoodShader.light_at`), or of lamps nearby. All else as `Shader.forward` takes it; batches
    broadcast, and gradients flow to the field and to all that gradients of the shader flow to.
    Law: a field that is the same everywhere gives what `shader` gives under that light.
    It takes C N V numbers of memory an eye and pose, whatever the layers are.

    Raises InputError as `Shader.forward`, if the field is of other receivers or another order, or if it is float64 and
    the shader is not, or the other way around.
    Source: Sloan, Kautz and Snyder 2002, sections 6.1 and 8.
    """
    if field.ndim < 3 or field.shape[-1] != 3 or field.shape[-3] != shader.vertices:
        raise InputError(
            f"field has shape {list(field.shape)}: give a light for each of the {shader.vertices} receivers, "
            f"[..., {shader.vertices}, {shader.order**2}, 3]"
        )
    if field.shape[-2] != shader.order**2:
        raise InputError(
            f"field has {field.shape[-2]} coefficients but the transfer is of order {shader.order}: project the lights "
            f"with order={shader.order}"
        )
    wide = shader.turn.project.dtype
    if not field.is_floating_point() or torch.promote_types(field.dtype, torch.float32) != wide:
        raise InputError(f"field is {field.dtype} but the shader works in {wide}: convert it with .to({wide})")
    shader.check_given(eye, view, frames, positions)
    turned = None if frames is None and positions is None else shader.pose(frames, positions)
    # Channels first, and receivers last as vectors have them.
    light = field.to(shader.dtype).movedim((-1, -2), (0, 1))
    radiance: Tensor | None = None
    for layer in shader.layers.values():
        posed = None if turned is None else layer.among(turned, -3)
        values = layer.values(eye, view, posed, positions)
        vectors = layer.toward(values, posed)
        columns = vectors.shape[1]
        lit = layer.among(light[:, :columns], -1)
        batch = max(lit.ndim, vectors.ndim) - 3
        one, other = (
            part.reshape(*part.shape[:2], *(1,) * (batch - part.ndim + 3), *part.shape[2:]) for part in (vectors, lit)
        )
        sent = (one * other).sum(1).movedim(0, -2) * layer.weight.T
        radiance = layer.spread(sent.to(layer.weight.dtype), radiance, shader.vertices)
    assert radiance is not None
    return radiance.mT.to(field.dtype)
