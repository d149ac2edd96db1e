"""Rooms that are called like their verb."""

import sys
import types
from collections.abc import Callable
from typing import Any


def call_room(name: str, verb: Callable[..., Any]) -> None:
    """Makes the module `name` callable as `verb`.

    Importing a room puts it under its name in `torchprt`, over any function of that name: so it is callable itself.
    """

    class Verb(types.ModuleType):
        def __call__(self, *arguments: Any, **options: Any) -> Any:
            return verb(*arguments, **options)

    sys.modules[name].__class__ = Verb
