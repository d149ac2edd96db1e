"""What is worked out in float32 at least, whatever the products are: directions, rotations, tables, indices."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ClassVar, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.errors import InputError

F = TypeVar("F", bound=Callable[..., Any])


def at_least_single(dtype: torch.dtype) -> torch.dtype:
    """float32, or `dtype` if it is wider."""
    return torch.promote_types(dtype, torch.float32)


def widened(values: Tensor) -> Tensor:
    """`values` in float32, or as they are if they are wider."""
    return values.to(at_least_single(values.dtype))


def whole_rotation(rotation: Float[Tensor, "*B 3 3"]) -> Float[Tensor, "*B 3 3"]:
    """`rotation` in float32 at least; one that was rounded to a narrow type as the nearest rotation, to 1e-8.

    Source: Higham 2008, "Functions of matrices", section 8.3 (two steps of Newton and Schulz's iteration: what is off
    by e is then off by e^4).
    """
    wide = widened(rotation)
    if wide.dtype == rotation.dtype:
        return rotation
    for _ in range(2):
        gram = (wide.unsqueeze(-1) * wide.unsqueeze(-2)).sum(-3)
        # `wide @ gram`, without the overhead and the autocast of products of 3x3.
        wide = 1.5 * wide - 0.5 * (wide.unsqueeze(-1) * gram.unsqueeze(-3)).sum(-2)
    return wide


def without_autocast(function: F) -> F:
    """`function` as it is without autocast, for the device of its first tensor.

    Autocast would make products of directions with 8 bits, and round the points at which a light is read.
    """

    @functools.wraps(function)
    def exact(*arguments: Any, **named: Any) -> Any:
        device = next(value for value in arguments if isinstance(value, Tensor)).device.type
        # Left only where it is on: a graph that is exported would keep the change as an operator.
        if not torch.amp.is_autocast_available(device) or not torch.is_autocast_enabled(device):
            return function(*arguments, **named)
        with torch.autocast(device, enabled=False):
            return function(*arguments, **named)

    return exact  # type: ignore[return-value]


class KeepsSingle(nn.Module):
    """A module whose buffers and parameters named in `single` stay float32 when it is converted to a narrower type.

    `.half()`, `.bfloat16()` and `.to(dtype)` then narrow what products read, and no place and no direction.
    """

    single: ClassVar[tuple[str, ...]] = ()

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> KeepsSingle:
        held = [getattr(self, name, None) for name in self.single]
        held += [tensor.grad for tensor in held if isinstance(tensor, nn.Parameter)]
        kept = {id(tensor): tensor for tensor in held if tensor is not None}

        def narrowed_not_here(tensor: Tensor) -> Tensor:
            made = fn(tensor)
            if tensor.is_meta and not made.is_meta:
                raise InputError(
                    "a module on the meta device has no values, and no state dict holds all of them: make it again, "
                    "on a device that is there"
                )
            if id(tensor) in kept and made.dtype != at_least_single(made.dtype):
                return tensor.to(made.device, torch.float32)
            return made

        return super()._apply(narrowed_not_here, recurse)
