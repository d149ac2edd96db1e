"""Python's garbage collector rests while the command loads torch, which makes no garbage worth looking for.

Loading it makes some hundred thousand objects that stay; collections that run meanwhile, and the one when Python ends,
are a quarter of the time. Only the command does this: what a program that imports `torchprt` has chosen stays as it is.
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


class _Resting(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds `torch` as all other finders do, and loads it while the collector rests."""

    def __init__(self) -> None:
        self.loader: importlib.abc.Loader | None = None
        """Of torch itself."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name != "torch" or self.loader is not None:
            return None
        # Without itself, or it would be asked again.
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            self.loader, spec.loader = spec.loader, self
        return spec

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        assert self.loader is not None
        return self.loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        assert self.loader is not None
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
    """Within it, the collector rests while torch is imported for the first time in this process."""
    finder = _Resting()
    if "torch" not in sys.modules:
        sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        if finder in sys.meta_path:
            sys.meta_path.remove(finder)
