"""What every kind of transfer says about the bake that it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Transport = Literal["unshadowed", "shadowed", "interreflected"]


@dataclass(kw_only=True)
class Provenance:
    """Metadata of a bake, described at `DiffuseTransfer`."""

    transport: Transport = "shadowed"
    bounces: int = 0
    rays: int = 0
    seed: int = 0
    error: float | None = None
    signal: float | None = None
    version: str = ""
