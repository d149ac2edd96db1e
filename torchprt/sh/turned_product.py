"""Products of lights with vectors that are turned one by one, without turning them whole."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import euler
from torchprt.sh.basis import bands, order_of
from torchprt.sh.constant import remembered


class TurnedProduct:
    """`sum_i light_i rotate(vector, rotation)_i`, for values alone: no gradients flow.

    Of the three Euler turns the last, and the swap of axes before it, are moved onto the light, for which they are the
    same for all vectors: a light becomes 2 n - 1 rows a channel, whose products with the vector after its second turn
    are weighted with the cosines and sines of the last. Half of the work of `sh.rotate`, and no copies.
    `turns [3, G]`, complex: what `euler_turns` makes of rotations.
    Source: as `turn_by_euler`.
    """

    def __init__(self, light: Float[Tensor, "*B N C"]):
        self.order, self.shape = order_of(light.shape[-2]), (*light.shape[:-2], light.shape[-1])
        swap, self.mirrored, self.size_of_m, self.sine_of_m = euler._constants(light.device, self.order, light.dtype)
        self.swap = swap
        same, mirrored = _folds(light.device, self.order, light.dtype)
        rows = light.mT.unsqueeze(-2)
        folded = torch.cat([rows * same, rows[..., self.mirrored] * mirrored], -2)
        self.rows = (folded @ torch.block_diag(*swap)).reshape(math.prod(self.shape) * folded.shape[-2], self.order**2)

    def __call__(self, vectors: Float[Tensor, "N G"], turns: Tensor) -> Float[Tensor, "*B C G"]:
        powers = euler._powers(turns, self.order)
        mixed = self._about_z(vectors, powers[0])
        swapped = torch.empty_like(mixed)
        sizes = [len(block) for block in self.swap]
        for block, row, result in zip(self.swap, mixed.split(sizes), swapped.split(sizes), strict=True):
            torch.mm(block, row, out=result)
        tilted = self._about_z(swapped, powers[1], mixed)
        last = torch.cat([powers[2].real, powers[2].imag[1:]])
        found = (self.rows @ tilted).view(*self.shape, len(last), vectors.shape[-1])
        return found.mul_(last).sum(-2)

    def _about_z(self, vectors: Tensor, powers: Tensor, out: Tensor | None = None) -> Tensor:
        sines = powers.imag
        cosine = powers.real.contiguous().index_select(0, self.size_of_m)
        sine = torch.cat([sines, -sines]).index_select(0, self.sine_of_m)
        out = torch.empty_like(vectors) if out is None else out
        torch.index_select(vectors, 0, self.mirrored, out=out)
        return out.mul_(sine).addcmul_(cosine, vectors)


def euler_turns(rotation: Float[Tensor, "3 3 G"]) -> Tensor:
    """e^(it) of the three turns of each rotation `[:, :, g]`, complex `[3, G]`; they are not checked."""
    return euler._euler(rotation)


@remembered(32)
def _folds(order: int, dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    """Which coefficients of a light stand in the rows of the cosines of m = 0 to n - 1, and with which sign, mirrored,
    in those of the sines of 1 to n - 1: `[n, N]` and `[n - 1, N]`."""
    band = bands(order)
    m = torch.arange(order**2) - band * (band + 1)
    size = torch.arange(order)[:, None]
    same = (m.abs() == size).to(dtype)
    mirrored = (torch.where(m > 0, 1, -1) * (m.abs() == size))[1:].to(dtype)
    return same.contiguous(), mirrored.contiguous()
