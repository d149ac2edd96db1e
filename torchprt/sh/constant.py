"""Functions whose result a compiler may take as it is."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

Marked = TypeVar("Marked", bound=Callable)


def assume_constant(function: Marked) -> Marked:
    """`torch.compiler.assume_constant_result`, without loading the compiler: a second of every start of a program.

    The mark is read when the compiler meets the function, so it need not be there before.
    """
    function._dynamo_marked_constant = True  # type: ignore[attr-defined]
    return function
