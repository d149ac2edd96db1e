"""A batch of lights and a batch of transfer vectors, as few matrix products as their dimensions allow."""

from __future__ import annotations

import math

import torch
from jaxtyping import Complex, Float, Num
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh.shapes import broadcast_shapes


def light_product(
    light: Float[Tensor, "*#B N 3"], vectors: Float[Tensor, "C N *#B V"], *, out: Tensor | None = None
) -> Float[Tensor, "... 3 V"]:
    """`sum_i vectors_i light_i`; a dimension of the batch in which `vectors` has size 1 only adds lights to a product.

    One matrix product if the vectors have no batch; C = 1, or 3, a channel of the light each. `out [*B, V, 3]`: a
    former result of vectors without a batch, to write over; InputError if it is not of this batch.
    """
    channels, count = vectors.shape[:2]
    if vectors.ndim == 3:
        return _of_one_batch(light, vectors, out)
    batch = broadcast_shapes(light.shape[:-2], vectors.shape[2:-1])
    poses = (1,) * (len(batch) - vectors.ndim + 3) + tuple(vectors.shape[2:-1])
    paired = [axis for axis, size in enumerate(poses) if not is_one(size)]
    shared = [axis for axis in range(len(poses)) if axis not in paired]
    matrices = vectors.movedim(1, -2).reshape(channels * math.prod(poses), count, vectors.shape[-1])
    colour = len(batch)
    order = [colour, *paired, *shared] if channels == 3 else [*paired, *shared, colour]
    sizes = [(*batch, 3)[axis] for axis in order]
    rows = light.mT.expand(*batch, 3, count).permute(*order, -1)
    # Not `len`, which would be a constant of a graph.
    many = matrices.shape[0]
    rows = rows.reshape(many, math.prod(sizes) // max(many, 1), count)
    products = torch.mm(rows[0], matrices[0]) if is_one(many) else torch.bmm(rows, matrices)
    back = sorted(range(len(order)), key=order.__getitem__)
    return products.view(*sizes, vectors.shape[-1]).permute(*back, -1)


def _of_one_batch(light: Tensor, vectors: Tensor, out: Tensor | None) -> Tensor:
    channels, count, vertices = vectors.shape
    batch = light.shape[:-2]
    many = math.prod(batch)
    if channels == 1:
        memory = None if out is None else _memory(out, out.mT, (*batch, 3, vertices)).view(3 * many, vertices)
        flat = light.mT.reshape(3 * many, count)
        return torch.mm(flat, vectors[0], out=memory).view(*batch, 3, vertices)
    # Every channel has its own transfer: channels come first, in the light and in the memory of the result.
    memory = None if out is None else _memory(out, out.movedim(-1, 0), (3, *batch, vertices)).view(3, many, vertices)
    flat = light.movedim(-1, 0).reshape(3, many, count)
    return torch.bmm(flat, vectors, out=memory).view(3, *batch, vertices).movedim(0, -2)


def receivers_of(values: Num[Tensor, "*B G"] | Complex[Tensor, "*B G"], index: Tensor) -> Tensor:
    """`values[..., index]`; as a matrix, whose columns are read four times faster than those of a larger tensor."""
    count = values.shape[-1]
    if values.is_contiguous():
        rows = values.view(-1, count) if count else values.flatten(0, -2)
        return rows.index_select(1, index).view(*values.shape[:-1], len(index))
    if values.ndim > 2:
        return torch.stack([receivers_of(part, index) for part in values.unbind(0)])
    return values.index_select(-1, index)


def is_one(size: int) -> bool:
    """Whether a dimension has size 1; in a traced graph whether it always has, so that a free batch stays free."""
    if not torch.compiler.is_compiling():
        return size == 1
    from torch.fx.experimental.symbolic_shapes import statically_known_true

    return statically_known_true(size == 1)


def _memory(out: Tensor, memory: Tensor, shape: tuple[int, ...]) -> Tensor:
    """`memory`, the view of `out` that a product writes; InputError if it is not of this `shape` in one piece."""
    if memory.shape != shape or not memory.is_contiguous():
        raise InputError(
            f"out must be a former result for this batch of lights and {shape[-1]} vertices: "
            f"it has shape {tuple(out.shape)} and strides {out.stride()}"
        )
    return memory
