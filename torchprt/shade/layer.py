"""Layers at run time: a signal, its weight, and the functions of the eye that its rows are weighted with."""

from __future__ import annotations

import abc
import copy
import functools
from collections.abc import Sequence
from typing import ClassVar, TypeVar, cast

from jaxtyping import Float
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.sh.precision import KeepsSingle
from torchprt.sh.shapes import broadcast_shapes
from torchprt.shade.dense import DenseSignal
from torchprt.shade.levels import Levels, LinearLevels
from torchprt.shade.signal import Making, SignalModule, hold, signal_module
from torchprt.transfer import Diffuse, Layer

M = TypeVar("M", bound="LayerModule")


class LayerModule(KeepsSingle, abc.ABC):
    """A layer of G receivers: `weight * sum_i values_i sum_j M_ij light_j`.

    A subclass is made from its stored layer as `(layer, making)`, and says in `values` which
    functions of the eye there are. `choices` are keyword arguments of `shader`, those that the class or the class of
    its signal names. It is registered for the stored layer with `layer_module.register`.
    Buffers, or parameters if named in `learn`: the weight, under its name, and those of `signal`. `receivers [G]`:
    which of all receivers it is about, None for all.
    """

    learnable: ClassVar[tuple[str, ...]] = ()
    choices: ClassVar[tuple[str, ...]] = ()
    # Buffers whose last dimension is the receivers.
    per_receiver: ClassVar[tuple[str, ...]] = ()
    # How fast what is seen changes with the direction of the eye: as functions of this order.
    exit_order: int = 1

    signal: SignalModule
    receivers: Tensor | None
    # Bands of the light that it answers to, None for all.
    bands: int | None = None

    def __init__(self, layer: Layer, making: Making, lost: Tensor | None = None):
        """`lost [.]`: numbers of the receivers, among those of the layer, that have nothing."""
        super().__init__()
        self.weight_name, self.needs = layer.weight_name, layer.needs & {"eye"}
        hold(self, layer.weight_name, layer.weight, making)
        index = layer.index(making.receivers.count)
        self.register_buffer("receivers", None if len(index) == making.receivers.count else index)
        self.signal = signal_module(layer.signal, making, lost)

    @property
    def weight(self) -> Float[Tensor, "#G #3"]:
        return cast(Tensor, getattr(self, self.weight_name))

    def values(
        self, eye: Tensor | None, view: Tensor | None, frames: Tensor | None = None, positions: Tensor | None = None
    ) -> Float[Tensor, "*B G M"] | None:
        """The functions of the eye for all receivers of the layer in a pose; None if there is one row and no eye.

        `frames`, of these receivers, and `positions`, of all, as the shader takes them.
        """
        return None

    def toward(self, values: Tensor | None, frames: Tensor | None = None) -> Float[Tensor, "C N ..."]:
        """Transfer vectors `[C, N, *B, G]` toward eyes in poses, without the weight."""
        return self.signal.toward(values, frames)

    def under(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        """What the rows send under lights, without the weight, at rest."""
        return self.signal.under(light)

    def sent(
        self, light: Tensor, values: Tensor | None, frames: Tensor | None, out: Tensor | None
    ) -> Float[Tensor, "... 3 G"]:
        """Radiance without the weight."""
        return self.signal.radiance(light, values, frames, out=out)

    def forward(
        self, light: Tensor, values: Tensor | None = None, frames: Tensor | None = None, out: Tensor | None = None
    ) -> Float[Tensor, "... 3 G"]:
        """Radiance `[*B, 3, G]` under lights of the world, toward the eyes of `values`, in poses; in the dtype of the
        weight, as everything that it is made of."""
        light, weight = self.lit(light), self.weight
        if weight.shape[0] == 1:
            # One weight for all receivers: applied to N numbers instead of G.
            return self.sent(light * weight, values, frames, out).to(weight.dtype)
        radiance = self.sent(light, values, frames, out)
        # Autocast may have made it narrower.
        return (radiance * weight.T).to(weight.dtype) if out is None else radiance.mul_(weight.T)

    def lit(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B n 3"]:
        """Of a light what the layer answers to."""
        return light if self.bands is None else light[..., : self.bands**2, :]

    def at_order(self: M, order: int, index: Tensor) -> M:
        """About those of its receivers that `index` names, for the first `order` bands of the light."""
        made = self.taken(index, self.signal.part(0, order, index))
        made.bands = order
        return made

    def levels(self, orders: Sequence[int]) -> Levels:
        """The layer at rising orders of the light, for adaptive shading; InputError if that has no meaning for it."""
        return LinearLevels(self, orders)

    def spread(self, values: Float[Tensor, "*#B G"], below: Float[Tensor, "*#B V"] | None, count: int) -> Tensor:
        """Values of its receivers put among all `count`, over those of the layers `below`."""
        if self.receivers is None:
            return values if below is None else below + values
        if below is None:
            below = values.new_zeros(*values.shape[:-1], count)
        batch = broadcast_shapes(values.shape[:-1], below.shape[:-1])
        # Three times faster than index_add here, and no receiver is named twice.
        places = self.receivers.expand(*batch, len(self.receivers))
        return below.expand(*batch, count).scatter_add(-1, places, values.expand(*batch, len(self.receivers)))

    def among(self, values: Tensor, dimension: int) -> Tensor:
        """Of `values` of all receivers those of its own."""
        return values if self.receivers is None else values.index_select(dimension, self.receivers)

    def posed(self: M, frames: Tensor | None, positions: Tensor | None) -> M:
        """The layer in one pose, its transfer stored; `frames` of its own receivers, `positions` of all."""
        return self.changed(signal=DenseSignal.holding(self.toward(None, frames).to(self.weight.dtype).contiguous()))

    def taken(self: M, index: Tensor, signal: SignalModule) -> M:
        """About those of its receivers that `index` names, one perhaps more than once, whose transfer is `signal`."""
        weight = self.weight[index] if len(self.weight) > 1 else self.weight
        receivers = index if self.receivers is None else self.receivers[index]
        held = {name: getattr(self, name) for name in self.per_receiver if getattr(self, name, None) is not None}
        moved = {name: v[..., index] for name, v in held.items() if v.shape[-1:] == (self.signal.shape[0],)}
        return self.changed(signal=signal, receivers=receivers, **moved, **{self.weight_name: weight})

    def changed(self: M, **parts: Tensor | nn.Module | None) -> M:
        """The same with other buffers or submodules; all others are shared."""
        made = copy.copy(self)
        made._buffers, made._modules = dict(self._buffers), dict(self._modules)
        made._parameters = dict(self._parameters)
        for name, part in parts.items():
            made._parameters.pop(name, None)
            if isinstance(part, nn.Module):
                made._modules[name] = part
            else:
                made._buffers[name] = part
        return made


@functools.singledispatch
def layer_module(layer: Layer, making: Making) -> LayerModule:
    """The module of a stored layer, by its class."""
    raise InputError(f"a layer of kind '{layer.kind}' has no shader: register one with shade.layer_module.register")


@layer_module.register(Diffuse)
class DiffuseLayer(LayerModule):
    """Diffuse exit radiance, `albedo * transfer . light`; `learn` may name "albedo" and what the signal has."""

    learnable = ("albedo",)
    albedo: Tensor

    @classmethod
    def holding(cls, vectors: Float[Tensor, "C N V"], albedo: Tensor) -> DiffuseLayer:
        """Of vectors and albedo as they are, through which gradients may flow."""
        made = cls.__new__(cls)
        nn.Module.__init__(made)
        made.weight_name, made.needs = Diffuse.weight_name, Diffuse.needs
        made.register_buffer("albedo", albedo)
        made.register_buffer("receivers", None)
        made.signal = DenseSignal.holding(vectors)
        return made
