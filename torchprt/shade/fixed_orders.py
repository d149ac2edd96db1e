"""A shader whose receivers each stand at an order of the light, once and for all."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.shade.layer import LayerModule
from torchprt.shade.shader import Shader
from torchprt.words import count


def fixed_orders(shader: Shader, orders: Mapping[str, Int[Tensor, "G"]]) -> Shader:
    """The shader with the receivers of some layers at lower orders of the light, for graphs and for the least memory.

    `orders`, by name of the layer: for each of its receivers how many bands of the light it answers to, as the
    `regions.orders` of an `AdaptiveShader` that was called with a batch of lights and eyes that matter; several of
    those are joined with `torch.maximum`. Receivers of one order are one layer, called NAME_ORDER, and one product.
    Its transfer is a copy of what is read. Layers that are not named stay.

    Laws: linear in the light; what `orders` says is what adaptive shading of that order gives; all orders that of the
    light is the shader, to rounding. A light that was not among those that chose the orders lacks what it has in the
    bands that are left out.
    Raises InputError if there is no such layer, the numbers of receivers differ, an order is below 1 or above that of
    the shader, or a receiver of the layer costs the same at any order.
    """
    for name, chosen in orders.items():
        _check(shader, name, chosen)
    layers: dict[str, LayerModule] = {}
    for name, layer in shader.layers.items():
        if name not in orders or not layer.signal.shape[0]:
            layers[name] = layer
            continue
        chosen = orders[name].to(layer.weight.device)
        for order in torch.unique(chosen).tolist():
            layers[f"{name}_{order}"] = layer.at_order(order, (chosen == order).nonzero()[:, 0])
    return Shader(layers, shader.turn, shader.vertices, shader.estimate)


def _check(shader: Shader, name: str, chosen: Tensor) -> None:
    if name not in shader.layers:
        known = ", ".join(f"'{each}'" for each in shader.layers)
        raise InputError(f"orders name a layer '{name}': the shader has {known}")
    layer = shader.layers[name]
    receivers = layer.signal.shape[0]
    if chosen.shape != (receivers,) or chosen.is_floating_point():
        raise InputError(
            f"orders of layer '{name}' have shape {list(chosen.shape)} and dtype {chosen.dtype}: give a whole number "
            f"for each of its {count(receivers, 'receiver')}"
        )
    if receivers and not 1 <= int(chosen.min()) <= int(chosen.max()) <= shader.order:
        raise InputError(
            f"orders of layer '{name}' are {int(chosen.min())} to {int(chosen.max())}: they must be 1 to "
            f"{shader.order}, the shader's"
        )
    layer.levels((shader.order,))
