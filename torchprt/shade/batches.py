"""A batch of lights and a batch of transfer vectors, as few matrix products as their dimensions allow."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError


def light_product(
    light: Float[Tensor, "*#B N 3"], vectors: Float[Tensor, "C N *#B V"], *, out: Tensor | None = None
) -> Float[Tensor, "... 3 V"]:
    """`sum_i vectors_i light_i`; a dimension of the batch in which `vectors` has size 1 only adds lights to a product.

    One matrix product if the vectors have no batch; C = 1, or 3, a channel of the light each. `out [*B, V, 3]`: a
    former result to write over; InputError if it is not of this batch.
    """
    channels, count = vectors.shape[:2]
    batch = torch.broadcast_shapes(light.shape[:-2], vectors.shape[2:-1])
    poses = (1,) * (len(batch) - vectors.ndim + 3) + tuple(vectors.shape[2:-1])
    paired = [axis for axis, size in enumerate(poses) if size != 1]
    shared = [axis for axis, size in enumerate(poses) if size == 1]
    matrices = vectors.movedim(1, -2).reshape(channels * math.prod(poses), count, vectors.shape[-1])
    colour = len(batch)
    order = [colour, *paired, *shared] if channels == 3 else [*paired, *shared, colour]
    sizes = [(*batch, 3)[axis] for axis in order]
    rows = light.mT.expand(*batch, 3, count).permute(*order, -1)
    rows = rows.reshape(len(matrices), math.prod(sizes) // max(len(matrices), 1), count)
    memory = None if out is None else _memory(out, order, [*sizes, vectors.shape[-1]], rows.shape[:2])
    if len(matrices) == 1:
        products = torch.mm(rows[0], matrices[0], out=None if memory is None else memory[0])
    else:
        products = torch.bmm(rows, matrices, out=memory)
    back = sorted(range(len(order)), key=order.__getitem__)
    return products.view(*sizes, vectors.shape[-1]).permute(*back, -1)


def _memory(out: Tensor, order: list[int], sizes: list[int], rows: torch.Size) -> Tensor:
    """`out` as the rows of vertices that a product writes."""
    vertices = sizes[-1]
    lanes = out.mT.permute(*order, -1) if out.ndim == len(sizes) else out
    if list(lanes.shape) != sizes or not lanes.is_contiguous():
        raise InputError(
            f"out must be a former result for this batch of lights and {vertices} vertices: "
            f"it has shape {tuple(out.shape)} and strides {out.stride()}"
        )
    return lanes.view(*rows, vertices)
