"""Signals at run time: stored transfer put under a light, or contracted with functions of the eye."""

from __future__ import annotations

import abc
import functools
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.sh.precision import KeepsSingle, at_least_single
from torchprt.shade.batches import light_product
from torchprt.transfer import Receivers, Signal


@dataclass(frozen=True)
class Making:
    """What the modules of a layer and of its signal are made with: the dtype of all that a product reads, names of
    buffers that become parameters, and what the caller of `shader` chose of the `choices` that they leave open."""

    receivers: Receivers
    dtype: torch.dtype
    learn: Collection[str] = ()
    choices: Mapping[str, Any] = field(default_factory=dict)


class SignalModule(KeepsSingle, abc.ABC):
    """The transfer matrices `[C, M, N]` of G receivers in buffers; M = 1 for transfer vectors.

    A subclass is made from its stored signal as `(signal, making, lost)`: receivers in `lost` have nothing. It must say
    `toward`; everything else follows from that, and is overridden where there is a faster way. It is registered for the
    stored signal with `signal_module.register`.
    """

    learnable: ClassVar[tuple[str, ...]] = ()
    choices: ClassVar[tuple[str, ...]] = ()
    follows_pose: ClassVar[bool] = False
    # Whether a receiver costs less in fewer bands of the light.
    costs_by_order: ClassVar[bool] = True

    def __init__(self, shape: tuple[int, int, int, int]) -> None:
        """`shape`: G, C, M, N."""
        super().__init__()
        self.shape = shape

    @abc.abstractmethod
    def toward(
        self, values: Float[Tensor, "*#B G M"] | None, frames: Float[Tensor, "*#B G 3 3"] | None = None
    ) -> Float[Tensor, "C N ..."]:
        """Transfer vectors `sum_i values_i M_ij`, `[C, N, *B, G]`, in a pose; without `values` those stored."""

    def under(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        """`sum_j M_ij light_j`, at rest."""
        receivers, _, rows, _ = self.shape
        single = torch.eye(rows, dtype=light.dtype, device=light.device)[:, None].expand(rows, receivers, rows)
        return light_product(light.unsqueeze(-3), self.toward(single)).transpose(-3, -2)

    def applied(self, columns: Float[Tensor, "N K"]) -> Float[Tensor, "G K"]:
        """`vectors @ columns` of vectors with one channel."""
        return self.toward(None)[0].mT @ columns

    def applied_in_pieces(self, rows: Float[Tensor, "K N"], size: int) -> Iterator[Float[Tensor, "K g"]]:
        """`rows @ vectors`, as `applied` but receivers last, `size` of them at a time, one piece after the other."""
        yield from self.applied(rows.mT).mT.split(size, 1)

    def part(self, first: int, last: int, receivers: Tensor | None = None) -> SignalModule:
        """Of those `receivers`, all if None, the columns of bands `first` to `last` - 1: what adaptive shading reads.

        Gradients flow to what it is a part of. Raises InputError if the signal cannot be taken apart.
        """
        raise InputError(
            f"a signal of class {type(self).__name__} cannot be taken apart by bands: write its method `part`, or call "
            "the shader itself, which is not adaptive"
        )

    def radiance(
        self, light: Tensor, values: Tensor | None, frames: Tensor | None = None, out: Tensor | None = None
    ) -> Float[Tensor, "... 3 G"]:
        """`sum_ij values_i M_ij light_j` in the order that is fastest, `[*B, 3, G]`, of `light [*B, N, 3]`, all else as
        for `toward`; `out` as for `light_product`."""
        return light_product(light, self.toward(values, frames), out=out)


@functools.singledispatch
def signal_module(signal: Signal, making: Making, lost: Tensor | None = None) -> SignalModule:
    """The module of a stored signal, by its class."""
    raise InputError(f"a signal of kind '{signal.kind}' has no shader: register one with shade.signal_module.register")


def hold(module: KeepsSingle, name: str, value: Tensor, making: Making) -> None:
    """Makes a buffer of `value` in the dtype of the shader, or a parameter, which is a copy, if it is to be learned.

    What the module names as `single` is float32 at least."""
    value = value.detach().to(at_least_single(making.dtype) if name in module.single else making.dtype)
    if name in making.learn:
        module.register_parameter(name, nn.Parameter(value.clone()))
    else:
        module.register_buffer(name, value)
