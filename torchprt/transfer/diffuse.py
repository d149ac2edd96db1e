"""Diffuse transfer: a vector a receiver."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import Layout, check_finite, check_signal
from torchprt.transfer.provenance import Provenance


@dataclass
class DiffuseTransfer(Provenance):
    """Diffuse transfer vectors of `V` receivers, in the world frame.

    Exit radiance under a light `l [N, 3]` is `albedo * sum_i transfer[:, i] l_i`: the vectors carry the `1/pi`
    and what light did on its way (shadows, and the albedo of the surfaces it bounced from); the receiver's own
    albedo is applied at run time.
    Source: Sloan, Kautz and Snyder 2002, sections 4.1 and 5.

    - `transfer [C, N, V]`: one channel unless light bounced off coloured surfaces. Vertices last: shading one
      light reads it as a stream. Any float dtype; float16 and bfloat16 are for storage.
    - `albedo [V or 1, 3 or 1]`: of the receivers, in [0, 1].
    - `positions [V, 3]`, `normals [V, 3]`, `faces [F, 3]`: what to draw; `faces` is empty for loose points.
      Two-sided objects record twice: the receivers of all first sides come first, then the reverse sides.
    - `transport`: "unshadowed", "shadowed" or "interreflected"; `bounces`: how many were added.
    - `rays`: hemisphere directions a receiver (0 if none was traced); `seed`: of the direction set.
    - `error`: estimated RMS error of a coefficient from the finite number of rays, over all receivers, and
      `signal`: RMS of a coefficient, so that `error / signal` is relative; both None if nothing was sampled.
    - `version`: of the torchprt that baked it.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "diffuse"
    layouts: ClassVar[dict[str, Layout]] = {
        "transfer": Layout(("C", "N", "V")),
        "albedo": Layout(("V|1", "3|1")),
        "positions": Layout(("V", "3"), (torch.float32, torch.float64)),
        "normals": Layout(("V", "3"), (torch.float32, torch.float64)),
        "faces": Layout(("F", "3"), (torch.int32, torch.int64)),
    }

    transfer: Tensor
    albedo: Tensor
    positions: Tensor
    normals: Tensor
    faces: Tensor

    def __post_init__(self) -> None:
        check_signal(self)

    @property
    def order(self) -> int:
        """Number of SH bands."""
        return round(self.transfer.shape[1] ** 0.5)

    @property
    def channels(self) -> int:
        return self.transfer.shape[0]

    @property
    def vertices(self) -> int:
        """Number of receivers V."""
        return self.transfer.shape[2]

    @property
    def bytes(self) -> int:
        """Bytes of the transfer vectors alone, which is what compression lowers."""
        return self.transfer.numel() * self.transfer.element_size()

    def to_order(self, order: int) -> DiffuseTransfer:
        """The first `order` bands. Raises InputError unless 1 <= order <= self.order."""
        if not 1 <= order <= self.order:
            raise InputError(f"order {order} is not between 1 and the {self.order} that the transfer has")
        return dataclasses.replace(self, transfer=self.transfer[:, : order * order].contiguous())

    def to(self, dtype: torch.dtype) -> DiffuseTransfer:
        """The same with transfer vectors stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        return dataclasses.replace(self, transfer=self.transfer.to(dtype))

    def check(self) -> None:
        """Raises InputError if a tensor holds NaN or infinity, an albedo leaves [0, 1] or a face names no vertex."""
        check_finite(self)
        if self.albedo.numel() and (self.albedo.min() < 0 or self.albedo.max() > 1):
            raise InputError("albedo of the transfer is outside [0, 1]: bake it again")
        if self.faces.numel() and (self.faces.min() < 0 or self.faces.max() >= self.vertices):
            raise InputError("faces of the transfer name vertices that it does not have: bake it again")
