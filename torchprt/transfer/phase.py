"""What a volume scatters in one direction more than in another."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layer import Layer
from torchprt.transfer.layout import WHOLE, Layout


@dataclass(kw_only=True, repr=False)
class Phase(Layer):
    """Source to transferred incident radiance inside of a volume, over the whole sphere, and how it is scattered.

    Under a light `l [N, 3]` of the world the radiance that arrives at the receiver from the direction s has the SH
    coefficients `I_i = sum_j M_ij l_j`, i < `output_order`^2. Toward the direction v it scatters
    `albedo * sum_i moments[band of i] y_i(-v) I_i`: the phase function is zonal, so it is a product per band.
    `moments [output_order]` are its Legendre moments, the first of which is 1: those of Henyey and Greenstein are g^l,
    g being the mean cosine of the angle by which light is turned. Where there is but that one, the volume is isotropic
    and its layer is `Diffuse`.

    Raises InputError if its rows are not the square of the count of moments, or they are none of a phase function.
    Source: Sloan, Kautz and Snyder 2002, section 7 and equations 6 and 12; Henyey and Greenstein 1941.
    """

    kind: ClassVar[str] = "phase"
    weight_name: ClassVar[str] = "albedo"
    needs: ClassVar[frozenset[str]] = frozenset({"eye"})
    matrices: ClassVar[bool] = True
    layouts: ClassVar[dict[str, Layout]] = {
        "albedo": Layout(("G|1", "3|1")),
        "receivers": Layout(("G",), WHOLE, optional=True),
    }

    albedo: Tensor
    moments: list[float] = field(default_factory=lambda: [1.0])

    def __post_init__(self) -> None:
        super().__post_init__()
        self.moments = [float(each) for each in self.moments]
        if self.signal.follows_pose:
            raise InputError("a volume does not turn with a surface: the signal of its phase cannot be in lobes")
        if self.signal.shape[2] != len(self.moments) ** 2:
            raise InputError(
                f"the phase function of the transfer has {len(self.moments)} moments: the signal has "
                f"{self.signal.shape[2]} rows, not their square"
            )
        if not all(map(math.isfinite, self.moments)) or self.moments[0] != 1 or max(map(abs, self.moments)) > 1:
            raise InputError("moments of the transfer are none of a phase function: the first is 1, none is larger")

    @property
    def output_order(self) -> int:
        """Number of SH bands of transferred incident radiance."""
        return len(self.moments)
