"""What is seen of a receiver: its transfer, and the functions of the eye that its rows are weighted with."""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar, cast

import torch
from jaxtyping import Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.dense import Dense
from torchprt.transfer.layout import REAL, WHOLE, Layout, Part, bytes_of, check_indices
from torchprt.transfer.signal import Signal

L = TypeVar("L", bound="Layer")


@dataclass(kw_only=True, repr=False)
class Layer(Part, abc.ABC):
    """One of the layers whose sum is exit radiance: `weight * sum_i e_i(eye) sum_j M_ij light_j`.

    - `signal`: the matrices M of the G receivers that it is about.
    - `receivers [G]`: which of all V they are, ascending; None for all.
    - `weight_name`: the field that is its weight, `[G or 1, 3 or 1]`, in [0, 1], which is applied at run time.
    - `needs`: what must be known beside the light: "eye", and "reflectance" if that is chosen when a shader is made.
    - `meets_light`: a light of the world is applied to the signal itself, whose columns are its SH coefficients.
    - `matrices`: its dense signal is one of matrices, be it of one row, and not of vectors; the other is converted.
    """

    family: ClassVar[dict[str, type[Any]]] = {}
    needs: ClassVar[frozenset[str]] = frozenset()
    meets_light: ClassVar[bool] = True
    matrices: ClassVar[bool] = False
    weight_name: ClassVar[str]

    signal: Signal
    receivers: Tensor | None = None

    def __post_init__(self) -> None:
        if isinstance(self.signal, Dense):
            self.signal = self.signal.laid_out(self.matrices)
        sizes = self.sizes()
        count = self.signal.shape[0]
        if sizes.get("G", count) != count:
            raise InputError(
                f"the {self.kind} layer of the transfer is about {sizes['G']} receivers, but its signal holds {count}"
            )

    @property
    def weight(self) -> Tensor:
        return cast(Tensor, getattr(self, self.weight_name))

    @property
    def order(self) -> int:
        """Number of SH bands of the light."""
        return math.isqrt(self.signal.shape[3])

    @property
    def bytes(self) -> int:
        """Bytes of its transfer and of tables that all receivers share."""
        tables = (value for name, value in self.tensors().items() if not self.layouts[name].shape[0].startswith("G"))
        return self.signal.bytes + bytes_of(*tables)

    def index(self, count: int) -> Int[Tensor, "G"]:
        """The numbers of its receivers among `count`."""
        if self.receivers is None:
            return torch.arange(count, device=self.weight.device)
        return self.receivers.long()

    def to(self: L, dtype: torch.dtype) -> L:
        """The same with its signal stored as `dtype`."""
        return self.replace(signal=self.signal.to(dtype))

    def to_order(self: L, order: int) -> L:
        """For lights of the first `order` bands; InputError unless it has them."""
        return self.replace(signal=self.signal.to_order(order))

    def take(self: L, index: Int[Tensor, "g"], receivers: Tensor | None) -> L:
        """About the receivers that `index` names among its own, which then are those of these numbers."""
        rows = {
            name: getattr(self, name)[index]
            for name, layout in self.layouts.items()
            if name != "receivers"
            and (layout.shape[0] == "G" or (layout.shape[0] == "G|1" and len(getattr(self, name)) > 1))
        }
        return self.replace(signal=self.signal.take(index), receivers=receivers, **rows)

    def check(self, of: str = "") -> None:
        """InputError if a tensor holds NaN or infinity, the weight leaves [0, 1], or `receivers` do not ascend."""
        super().check(of)
        self.signal.check(f"{of}signal.")
        if self.weight.numel() and (self.weight.min() < 0 or self.weight.max() > 1):
            raise InputError(f"{self.weight_name} of the transfer is outside [0, 1]: bake it again")
        chosen = self.receivers
        if chosen is not None and len(chosen) > 1 and not bool((chosen[1:] > chosen[:-1]).all()):
            raise InputError("receivers of the transfer must be in ascending order, each once: bake it again")

    def check_among(self, count: int) -> None:
        """InputError unless its receivers are among `count`."""
        if self.receivers is None and self.signal.shape[0] != count:
            raise InputError(
                f"the {self.kind} layer of the transfer holds {self.signal.shape[0]} receivers of {count}: say which"
            )
        if self.receivers is not None:
            check_indices("receivers", self.receivers, count)


@dataclass(kw_only=True, repr=False)
class Diffuse(Layer):
    """Diffuse transfer vectors, in the world frame.

    Exit radiance under a light `l [N, 3]` is `albedo * sum_i t_i l_i`: the vectors carry the `1/pi` and what light did
    on its way (shadows, and the albedo of the surfaces it bounced from); the receiver's own `albedo [G or 1, 3 or 1]`
    is applied at run time.
    Source: Sloan, Kautz and Snyder 2002, sections 4.1 and 5.
    """

    kind: ClassVar[str] = "diffuse"
    weight_name: ClassVar[str] = "albedo"
    layouts: ClassVar[dict[str, Layout]] = {
        "albedo": Layout(("G|1", "3|1")),
        "receivers": Layout(("G",), WHOLE, optional=True),
    }

    albedo: Tensor

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.signal.shape[2] != 1:
            raise InputError(
                f"a diffuse layer takes transfer vectors, but its signal has matrices of {self.signal.shape[2]} rows"
            )


@dataclass(kw_only=True, repr=False)
class EyeLayer(Layer):
    """What the layers that depend on the eye share.

    - `tangents [G, 3]`: unit, orthogonal to the normals. The rows tangent, normal x tangent, normal are the local frame
      of a receiver: local = frame @ world.
    - `specular [G or 1, 3 or 1]`: the weight.
    - `materials`: the reflectance, as text.
    """

    weight_name: ClassVar[str] = "specular"
    needs: ClassVar[frozenset[str]] = frozenset({"eye"})
    matrices: ClassVar[bool] = True
    layouts: ClassVar[dict[str, Layout]] = {
        "tangents": Layout(("G", "3"), REAL),
        "specular": Layout(("G|1", "3|1")),
        "receivers": Layout(("G",), WHOLE, optional=True),
    }

    tangents: Tensor
    specular: Tensor
    materials: list[str] = field(default_factory=list)
