"""What the cells of a volume scatter toward an eye: a phase function applied to transferred incident radiance."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import bands, basis
from torchprt.sh.precision import at_least_single
from torchprt.shade.layer import LayerModule, layer_module
from torchprt.shade.signal import Making
from torchprt.shade.view_directions import toward_eye
from torchprt.transfer import Phase


@layer_module.register(Phase)
class PhaseLayer(LayerModule):
    """Source radiance toward an eye, `albedo * sum_i moments_i y_i(-v) (M l)_i`, v the direction from the cell to it.

    A phase function is zonal, so it is a product per band; directions are those of the world, and no frame turns them.
    Buffers: `albedo` and those of the signal, of which `learn` may name some, `points [3, G]`, in the dtype of the
    positions if that is wider, and `shares [M]`, the moment of the band of every row; both are float32 at least.

    Laws: an eye at a cell, from which it has no direction, sees the mean over all; directions are computed from
    eye - position in the dtype of the wider, as in `EyeLayerModule`.
    Source: Sloan, Kautz and Snyder 2002, section 7 and equation 6; Henyey and Greenstein 1941.
    """

    learnable = ("albedo",)
    per_receiver = ("points",)
    single = ("points", "shares")
    albedo: Tensor
    points: Tensor
    shares: Tensor

    def __init__(self, layer: Phase, making: Making):
        super().__init__(layer, making)
        dtype = at_least_single(making.dtype)
        self.exit_order = layer.output_order
        points = making.receivers.positions[layer.index(making.receivers.count)]
        self.register_buffer("points", points.T.to(torch.promote_types(points.dtype, dtype)).contiguous())
        shares = torch.tensor(layer.moments, dtype=torch.float64)[bands(layer.output_order)]
        self.register_buffer("shares", shares.to(points.device, dtype))

    @property
    def frames(self) -> Float[Tensor, "3 3 G"]:
        """The axes of the world, for every cell."""
        return torch.eye(3, dtype=self.shares.dtype, device=self.shares.device)[..., None].expand(-1, -1, self.cells)

    @property
    def cells(self) -> int:
        return self.points.shape[1]

    def values(
        self, eye: Tensor | None, view: Tensor | None, frames: Tensor | None = None, positions: Tensor | None = None
    ) -> Float[Tensor, "*B G M"]:
        toward = toward_eye(self.points, eye, view).to(self.shares.dtype)
        toward = toward.expand(*toward.shape[:-1], self.cells)
        # Divided by the largest component first: the far and the near must not leave the range.
        largest = toward.detach().abs().amax(0)
        here = largest <= torch.finfo(toward.dtype).tiny ** 0.5
        scaled = torch.where(here, 1.0, toward / torch.where(here, 1.0, largest))
        away = scaled / torch.linalg.vector_norm(scaled, dim=0)
        seen = basis(-away.movedim(0, -1), self.exit_order) * self.shares
        if self.exit_order > 1:
            mean = seen.new_zeros(self.exit_order**2)
            mean[0] = 1 / math.sqrt(4 * math.pi)
            seen = torch.where(here.unsqueeze(-1), mean, seen)
        return seen.to(self.albedo.dtype)
