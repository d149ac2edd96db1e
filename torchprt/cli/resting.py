"""Python's garbage collector rests while the command loads torch and trimesh, which make no garbage worth looking for.

Loading torch makes some hundred thousand objects that stay; collections that run meanwhile, and the one when Python
ends, are a quarter of the time. Only the command does this: what a program that imports `torchprt` has chosen stays.
"""

from __future__ import annotations

import contextlib
import gc
import importlib.abc
import importlib.util
import sys
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

LARGE = ("torch", "trimesh")
"""Packages that come with hundreds of modules."""


class _Finder(importlib.abc.MetaPathFinder):
    """Finds large packages as all other finders do, to load them while the collector rests."""

    def __init__(self) -> None:
        self.awaited = set(LARGE)

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name not in self.awaited:
            return None
        # It is asked again at once, and must not answer.
        self.awaited.remove(name)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            spec.loader = _Resting(spec.loader)
        return spec


class _Resting(importlib.abc.Loader):
    """Loads as `loader` does, while the collector rests."""

    def __init__(self, loader: importlib.abc.Loader) -> None:
        self.loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        assert module.__spec__ is not None
        # From here on nothing tells that it was here; whoever asks for the source asks the loader.
        module.__spec__.loader = module.__loader__ = self.loader
        asked = gc.isenabled()
        gc.disable()
        try:
            self.loader.exec_module(module)
        finally:
            # Later collections, the one when Python ends among them, pass over what is here now.
            gc.freeze()
            if asked:
                gc.enable()


@contextlib.contextmanager
def resting() -> Iterator[None]:
    """Within it, the collector rests while a large package is imported for the first time in this process."""
    finder = _Finder()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
