"""Tables that depend on no tensor: made once, outside of whatever torch is doing to its caller, and kept."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

import torch
from torch import Tensor

P = ParamSpec("P")
R = TypeVar("R")
F = TypeVar("F", bound=Callable[..., Any])

REMEMBERED: list[Callable[..., Any]] = []
"""Every function that `remembered` made, for a test that tries them all."""


def remembered(most: int) -> Callable[[Callable[P, R]], Callable[Concatenate[torch.device, P], R]]:
    """`@remembered(64)`: a function of plain values becomes one of a device and those, with its last 64 results kept.

    It makes a tensor, or a tuple of them, on the CPU, without regard for devices. What is kept is what it makes in
    `plain_torch`, so neither is it of a mode, a transform or a graph that is being traced nor does it follow a default
    device; and it may be used in all of them: a mode that replaces tensors (fake ones, export) is handed it first, a
    graph that is compiled takes it as a constant. `.forget()` lets go of what is kept.
    """

    def decorated(make: Callable[P, R]) -> Callable[Concatenate[torch.device, P], R]:
        @functools.lru_cache(maxsize=most)
        def kept(device: torch.device, *key: Any) -> Any:
            with plain_torch():
                return _each(lambda tensor: tensor.to(device), make(*key))  # type: ignore[call-arg]

        stack_length = torch._C._len_torch_dispatch_stack

        @functools.wraps(make)
        def table(device: torch.device, *key: Any) -> Any:
            if not (stack_length() and a_mode_replaces_tensors()):
                return kept(device, *key)
            # As `torch.tensor` hands over what it has made. A device of fakes need not exist.
            lift = torch.ops.aten.lift_fresh.default
            return _each(lambda tensor: lift(tensor).to(device), kept(torch.device("cpu"), *key))

        table.forget = kept.cache_clear  # type: ignore[attr-defined]
        REMEMBERED.append(table)
        return cast(Callable[Concatenate[torch.device, P], R], constant(table))

    return decorated


def a_mode_replaces_tensors() -> bool:
    """Whether tensors that are made are fakes, or parts of a graph that is traced."""
    kinds = torch._C._TorchDispatchModeKey
    return any(torch._C._get_dispatch_mode(kind) is not None for kind in (kinds.FAKE, kinds.PROXY, kinds.FUNCTIONAL))


@contextlib.contextmanager
def plain_torch() -> Iterator[None]:
    """torch as it is when nothing is asked of it: no mode, default device, transform, inference mode or autocast."""
    from torch._functorch.pyfunctorch import temporarily_clear_interpreter_stack
    from torch.utils._python_dispatch import _disable_current_modes

    with contextlib.ExitStack() as stack:
        stack.enter_context(temporarily_clear_interpreter_stack())
        stack.enter_context(_disable_current_modes())
        # Default devices are a mode of functions, which this leaves.
        stack.enter_context(torch._C.DisableTorchFunction())
        # What is made in inference mode could never serve a gradient later.
        stack.enter_context(torch.inference_mode(False))
        stack.enter_context(torch.no_grad())
        stack.enter_context(torch.autocast("cpu", enabled=False))
        yield


def _each(function: Callable[[Tensor], Tensor], made: Any) -> Any:
    if isinstance(made, tuple):
        return tuple(_each(function, part) for part in made)
    return function(made) if isinstance(made, Tensor) else made


def constant(function: F) -> F:
    """`torch.compiler.assume_constant_result`, without loading the compiler, which takes longer than all else here.

    That function sets this attribute and no more; a test compares the two.
    """
    function._dynamo_marked_constant = True  # type: ignore[attr-defined]
    return function
