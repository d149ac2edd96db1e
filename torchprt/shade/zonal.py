"""Zonal lobes at run time: they turn with a surface that deforms, by turning their axes."""

from __future__ import annotations

import copy
from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.errors import InputError
from torchprt.sh.precision import widened
from torchprt.shade.batches import light_product
from torchprt.shade.lobes import lobe_vectors, table_radiance, turned_axes, turned_exact
from torchprt.shade.signal import Making, SignalModule, hold, signal_module
from torchprt.transfer import Zonal

Method = Literal["direct", "table"]


@signal_module.register(Zonal)
class ZonalSignal(SignalModule):
    """Zonal lobes in any pose. Functions of the eye are applied to the coefficients first: then all rows are one sum of
    M L lobes.

    Buffers `axis [M, L, 3, G]`, `coefficients [C, M, L, Z, G]`, `exact [C, M, J, G]`, each a parameter instead if it is
    named in `learn`; axes count as unit vectors whatever their length, and are float32 at least.

    `method`: "direct" makes the transfer vectors of a pose and applies the light to them: exact. "table" reads each
    lobe from a table of the light, as the paper's vertex shader: off by up to 3 % of a band (`lobes.table_radiance`),
    and slower on a CPU unless there are few lobes; it never holds N numbers a receiver.

    Laws: linear in the light; frames R F under the light D(R) give the same radiance; identity frames give the transfer
    that was fitted; channels do not mix. Shadows do not follow the pose, only turn with the surface.
    Source: Sloan, Luna and Snyder 2005, sections 4 and 5.
    """

    learnable = ("axis", "coefficients", "exact")
    choices = ("method",)
    follows_pose = True
    single = ("axis",)
    # Which of the columns of its lobes it is about: all, unless it is a part.
    columns: slice = slice(None)
    axis: Tensor
    coefficients: Tensor
    exact: Tensor

    def __init__(self, signal: Zonal, making: Making, lost: Tensor | None = None):
        super().__init__(signal.shape)
        self.method: Method = making.choices.get("method", "direct")
        if self.method not in get_args(Method):
            raise InputError(f"method '{self.method}' is unknown: use 'direct' or 'table'")
        for name in self.learnable:
            value = getattr(signal, name)
            if name == "axis":
                # Of unit length again if they were stored in half precision.
                half = value.dtype in (torch.float16, torch.bfloat16)
                value = normalize(value.double(), dim=2) if half else value
            elif lost is not None:
                value = value.index_fill(-1, lost, 0)
            hold(self, name, value, making)

    def lobes(
        self, values: Float[Tensor, "*#B G M"] | None, frames: Float[Tensor, "*#B G 3 3"] | None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Axes, coefficients, and bands 0 and 1 where they are exact, in a pose, as `lobe_vectors` takes them."""
        poses = 0 if frames is None else frames.ndim - 3
        batch = max(poses, 0 if values is None else values.ndim - 2)
        if frames is not None:
            frames = frames.reshape(*(1,) * (batch - poses), *frames.shape)
        weights, low = (_beside(widened(part), batch) for part in (self.coefficients, self.exact))
        if values is None:
            weights, low = weights[:, 0], low[:, 0]
        else:
            lanes = values.movedim(-1, 0)
            lanes = lanes.reshape(len(lanes), *(1,) * (batch - lanes.ndim + 2), *lanes.shape[1:])
            weights = (weights * lanes[:, None, None]).flatten(1, 2)
            low = (low * lanes[:, None]).sum(1)
        if low.shape[1]:
            low = turned_exact(low, frames)
        axes = turned_axes(self.axis.flatten(0, 1), frames)
        return _beside(axes, batch) if frames is None else axes, weights, low

    def toward(self, values: Tensor | None, frames: Tensor | None = None) -> Float[Tensor, "C N ..."]:
        return lobe_vectors(*self.lobes(values, frames)).to(self.coefficients.dtype)[:, self.columns]

    def part(self, first: int, last: int, receivers: Tensor | None = None) -> ZonalSignal:
        whole = self.exact.shape[2] > 0
        if whole and last < 2:
            raise InputError("bands 0 and 1 of zonal lobes are held as one: give orders of 2 or more")
        bands = last - 2 if whole else last
        held = {"axis": self.axis, "coefficients": self.coefficients[:, :, :, :bands], "exact": self.exact}
        made = copy.copy(self)
        made._buffers, made._parameters = dict(self._buffers), {}
        for name, value in held.items():
            made._buffers[name] = value if receivers is None else value.index_select(-1, receivers)
        count, channels, rows, _ = self.shape
        made.shape = (count if receivers is None else len(receivers), channels, rows, last * last - first * first)
        made.columns, made.method = slice(first * first, last * last), "direct"
        return made

    def radiance(
        self, light: Tensor, values: Tensor | None, frames: Tensor | None = None, out: Tensor | None = None
    ) -> Float[Tensor, "... 3 G"]:
        lobes = self.lobes(values, frames)
        if self.method == "table":
            return table_radiance(light, *lobes)
        return light_product(light, lobe_vectors(*lobes).to(light.dtype)[:, self.columns], out=out)


def _beside(values: Tensor, poses: int) -> Tensor:
    """`values [..., G]` with `poses` dimensions of size 1 before the last."""
    return values.reshape(*values.shape[:-1], *(1,) * poses, values.shape[-1])
