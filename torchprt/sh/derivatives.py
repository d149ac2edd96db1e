"""Kernels of torch that have a first derivative in reverse and no other, with all the others."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import grid_sample

Kernel = Callable[..., Tensor]


def with_all_derivatives(fast: Kernel, plain: Kernel, *tensors: Tensor) -> Tensor:
    """`fast(*tensors)`, with second derivatives, in forward mode and under torch.func as `plain`, of plain operations,
    has them; both give the same values.

    Values and first derivatives in reverse cost what those of `fast` do, but under torch.func, where the way is `plain`
    at once. A graph that is traced has `fast`.
    """
    if torch.compiler.is_compiling():
        return fast(*tensors)
    if torch._C._functorch.peek_interpreter_stack() is not None or torch.autograd.forward_ad._current_level >= 0:
        return plain(*tensors)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        made: Tensor = _FastOnce.apply(fast, plain, *tensors)  # type: ignore[no-untyped-call]
        return made
    return fast(*tensors)


class _FastOnce(torch.autograd.Function):
    """Backward of `fast`; of `plain`, made for it, if that is to be differentiated in turn."""

    @staticmethod
    def forward(ctx: Any, fast: Kernel, plain: Kernel, *tensors: Tensor) -> Tensor:
        ctx.plain = plain
        ctx.save_for_backward(*tensors)
        wanted = ctx.needs_input_grad[2:]
        with torch.enable_grad():
            ctx.given = [tensor.detach().requires_grad_(asked) for tensor, asked in zip(tensors, wanted, strict=True)]
            ctx.made = fast(*ctx.given)
        made: Tensor = ctx.made.detach()
        return made

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        wanted = ctx.needs_input_grad[2:]
        again = torch.is_grad_enabled()
        # Asked for in both cases: it raises if they were let go of.
        saved = ctx.saved_tensors
        given, made = (saved, ctx.plain(*saved)) if again else (ctx.given, ctx.made)
        asked = [tensor for tensor, is_asked in zip(given, wanted, strict=True) if is_asked]
        found = iter(torch.autograd.grad(made, asked, gradient, create_graph=again, retain_graph=True))
        return None, None, *(next(found) if is_asked else None for is_asked in wanted)


def read_bilinear(tables: Float[Tensor, "B C H W"], places: Float[Tensor, "B h w 2"]) -> Float[Tensor, "B C h w"]:
    """`grid_sample`, bilinear, without aligned corners, going on beyond the border, with all derivatives."""
    return with_all_derivatives(_grid_sample, _gathered, tables, places)


def _grid_sample(tables: Tensor, places: Tensor) -> Tensor:
    return grid_sample(tables, places, padding_mode="border", align_corners=False)


def _gathered(tables: Tensor, places: Tensor) -> Tensor:
    parts = []
    for axis, size in enumerate(reversed(tables.shape[2:])):
        place = (((places[..., axis] + 1) * size - 1) / 2).clamp(0, size - 1)
        low = place.detach().floor().clamp(0, max(size - 2, 0))
        parts.append((low.long(), (low + 1).clamp(max=size - 1).long(), (place - low).unsqueeze(1)))
    (left, right, across), (top, bottom, down) = parts
    texels, width = tables.flatten(2), tables.shape[3]

    def read(row: Tensor, column: Tensor) -> Tensor:
        index = (row * width + column).flatten(1).unsqueeze(1)
        return texels.gather(2, index.expand(-1, texels.shape[1], -1)).unflatten(2, row.shape[1:])

    upper = read(top, left) * (1 - across) + read(top, right) * across
    lower = read(bottom, left) * (1 - across) + read(bottom, right) * across
    return upper * (1 - down) + lower * down
