"""Who calls Embree: embreex a ray at a time, or packets of rays where that can be."""

from __future__ import annotations

import functools
import importlib.util
import os
import warnings
from collections.abc import Callable
from typing import Protocol

import numpy as np
from jaxtyping import Float, Float32, Int32
from torch import Tensor

from torchprt.errors import InputError
from torchprt.trace.hits import Hits

# The environment variable that names an engine, for whoever wants another than the fastest that works.
ENGINE = "TORCHPRT_ENGINE"


class EngineWarning(UserWarning):
    """The fast engine is installed and cannot be used."""


class CannotRun(Exception):
    """Why an engine does not work here, as part of a sentence."""


class Engine(Protocol):
    """A tree of triangles that answers rays; thread-safe, without the GIL. Arguments as those of `Tracer`.

    `at_once`: how many rays it answers fastest when asked what is visible."""

    at_once: int

    def visibility(
        self, origins: Float[Tensor, "v *S 3"], frames: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
    ) -> Float32[Tensor, "v D"]:
        """1 where the ray escapes, 0 where anything blocks it."""

    def hits(
        self, origins: Float[Tensor, "v *S 3"], frames: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
    ) -> Hits:
        """The nearest hit of every ray of every receiver."""

    def nearest(self, origins: Float32[np.ndarray, "E 3"], directions: Float32[np.ndarray, "E 3"]) -> Hits:
        """The nearest hit of single rays."""


Make = Callable[[Float32[np.ndarray, "V 3"], Int32[np.ndarray, "F 3"]], Engine]


def _embreex() -> Make:
    from torchprt.trace.embreex_engine import Embreex

    return Embreex


def _packets() -> Make:
    if importlib.util.find_spec("numba") is None:
        raise CannotRun("numba is not installed: `pip install 'torchprt[fast]'`")
    try:
        import numba  # noqa: F401
    except ImportError as fault:
        raise CannotRun(f"numba cannot be imported ({fault})") from fault
    from torchprt.trace.packets import Packets, try_on_a_triangle

    try_on_a_triangle()
    return Packets


# The fastest last.
_ENGINES = {"embreex": _embreex, "packets": _packets}


def engine(name: str) -> Make:
    """What makes an engine of triangles, by its name. Raises InputError if there is none of that name, or it does not
    work here: results of engines differ in a few rays, so none ever stands in for another that was asked for."""
    if name not in _ENGINES:
        raise InputError(f"there is no engine '{name}' for rays: choose from {', '.join(_ENGINES)}")
    try:
        return _ENGINES[name]()
    except CannotRun as fault:
        raise InputError(f"the engine '{name}' for rays cannot run here: {fault}") from fault


def chosen(few: bool = False) -> str:
    """The name of the engine that tracers take: what the environment variable TORCHPRT_ENGINE says, or "packets" if
    the extra `fast` is installed, else "embreex". For `few` rays, as of a picture, it is "embreex": packets take longer
    to load than they save.

    Warns with an EngineWarning, once, if packets are installed and do not fit this machine.
    """
    asked = os.environ.get(ENGINE, "")
    if asked:
        engine(asked)
        return asked
    return "embreex" if few else _fastest()


@functools.cache
def _fastest() -> str:
    if importlib.util.find_spec("numba") is None:
        return "embreex"
    try:
        _packets()
    except CannotRun as fault:
        warnings.warn(
            f"rays go to Embree one at a time, at some half of the speed, because packets cannot run here: {fault} "
            f"(set {ENGINE}=embreex to say no more of it)",
            EngineWarning,
            stacklevel=4,
        )
        return "embreex"
    return "packets"
