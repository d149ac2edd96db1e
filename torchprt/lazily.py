"""Rooms whose names are imported when they are first used, so that a command loads the parts that it needs."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Any


def lazily(room: str, places: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` (PEP 562) of the package `room`: each public name with the module in it that has it.

    A module of the package is had by its own name. Nothing else may have that: Python sets the module in its place as
    soon as that is imported.
    """

    def find(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module '{room}' has no attribute '{name}'")
        module = importlib.import_module(f"{room}.{places[name]}")
        found = module if places[name] == name else getattr(module, name)
        # Python asks no more.
        setattr(sys.modules[room], name, found)
        return found

    return find, lambda: sorted({*vars(sys.modules[room]), *places})
