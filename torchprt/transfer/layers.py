"""The layers that depend on the eye: what the rows of their matrices are weighted with."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layer import EyeLayer
from torchprt.transfer.layout import REAL, Layout
from torchprt.transfer.signal import columns_of

Projection = Literal["optimal", "reduced", "zero", "odd", "even"]


@dataclass(kw_only=True, repr=False)
class Exit(EyeLayer):
    """Exit-radiance matrices, with the BRDF baked in.

    The receiver sends `specular * sum_i e_i(v) sum_j M_ij l_j` toward the local direction v under a light `l [N, 3]` of
    the world; e_i are `sh.exit_functions(v, output_order, projection)`.
    Laws: linear in the light; the first bands of N answer to a light of lower order.
    Source: Sloan, Hall, Hart and Snyder 2003, section 3, equation 1.

    - `output_order`: of the exit functions; `projection`: which they are.
    - `exit_error`: what the exit functions cannot represent of the materials, unshadowed, under lights that are white
      over N; relative RMS, the worst material's.
    """

    kind: ClassVar[str] = "exit"

    output_order: int
    projection: Projection = "optimal"
    exit_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_rows("signal", self.signal.shape[2], self.output_order, self.projection)


@dataclass(kw_only=True, repr=False)
class Factored(EyeLayer):
    """Exit-radiance matrices of few rows: the BRDF is factored into functions of the eye and of the light.

    As `Exit`, with `u_i(v)` in place of e_i: `factors [M, H, H]` holds them at the texels of an equal-area map of the
    hemisphere, read bilinearly (`brdf.sample_hemisphere_map`). One BRDF for all receivers of the layer.
    `factor_error`: relative RMS of unshadowed exit radiance that the M products leave out, under lights that are white
    over N. Shadows make sharper light, of which they leave out more.
    Source: Sloan, Luna and Snyder 2005, section 5.
    """

    kind: ClassVar[str] = "factored"
    layouts: ClassVar[dict[str, Layout]] = EyeLayer.layouts | {"factors": Layout(("M", "H", "H"), REAL)}

    factors: Tensor
    factor_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.signal.shape[2] != len(self.factors):
            raise InputError(
                f"tensor 'factors' of the transfer holds {len(self.factors)} factors: the signal has "
                f"{self.signal.shape[2]} rows, one is needed for each"
            )


@dataclass(kw_only=True, repr=False)
class Incident(EyeLayer):
    """Source to transferred incident radiance: the BRDF is chosen at run time.

    Under a light `l [N, 3]` of the world the radiance that arrives at the receiver from the local direction s, zero
    below the horizon, has the SH coefficients `sum_j M_ij l_j`, i < `output_order`^2. `materials` are those that other
    surfaces see when light bounces.
    Source: Sloan, Kautz and Snyder 2002, section 4.2, equation 12, with the rows in the local frame as T'_p in Sloan,
    Hall, Hart and Snyder 2003, section 7.
    """

    kind: ClassVar[str] = "incident"
    needs: ClassVar[frozenset[str]] = frozenset({"eye", "reflectance"})

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = self.signal.shape[2]
        if rows == 0 or self.output_order**2 != rows:
            raise InputError(f"signal of the transfer has {rows} rows: it must be the square of the output order")

    @property
    def output_order(self) -> int:
        """Number of SH bands of transferred incident radiance."""
        return math.isqrt(self.signal.shape[2])


@dataclass(kw_only=True, repr=False)
class Visibility(EyeLayer):
    """Visibility alone, multiplied with the light at run time: a vector a receiver instead of a matrix.

    The visibility of a receiver in the local direction s is about `sum_k t_k h_k(s)`, t its vector in `signal` and
    h = `sh.hemisphere_basis(s, visibility_order)`. At the nodes s_d and weights w_d of
    `sh.gauss_legendre_hemisphere(degree)` it meets the light turned into the local frame; exit coefficients are
    `sum_d kernel[i, d] V(s_d) L(s_d)`, the weights are in `kernel [M, D]`, and exit radiance is
    `specular * sum_i e_i(v) ...` as in `Exit`. One BRDF for all receivers of the layer; shadows only.
    Source: Sloan, Kautz and Snyder 2002, section 4.2 (the product of light and visibility on the fly).

    - `light_order`: bands of the light; `output_order`, `projection`, `exit_error`: as in `Exit`.
    - `product_error`: what truncated visibility costs, relative RMS of exit radiance, estimated on some receivers.
    """

    kind: ClassVar[str] = "visibility"
    meets_light: ClassVar[bool] = False
    matrices: ClassVar[bool] = False
    layouts: ClassVar[dict[str, Layout]] = EyeLayer.layouts | {"kernel": Layout(("M", "D"), REAL)}

    kernel: Tensor
    degree: int
    light_order: int
    output_order: int
    projection: Projection = "optimal"
    exit_error: float | None = None
    product_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.signal.shape[1:3] != (1, 1):
            raise InputError("visibility of the transfer must be one vector a receiver, of one channel")
        if self.signal.follows_pose:
            raise InputError("visibility of the transfer turns with the frames of receivers: it cannot be in lobes")
        _check_rows("kernel", self.kernel.shape[0], self.output_order, self.projection)
        nodes = (self.degree // 2 + 1) * (self.degree + 1)
        if self.kernel.shape[1] != nodes:
            raise InputError(
                f"kernel of the transfer has {self.kernel.shape[1]} nodes: the rule of degree {self.degree} has {nodes}"
            )

    @property
    def order(self) -> int:
        return self.light_order

    @property
    def visibility_order(self) -> int:
        """Number of bands of visibility."""
        return math.isqrt(self.signal.shape[3])

    def to_order(self, order: int) -> Visibility:
        columns_of(order, self.light_order)
        return self.replace(light_order=order)


def _check_rows(name: str, rows: int, output_order: int, projection: str) -> None:
    if projection not in ("optimal", "reduced", "zero", "odd", "even"):
        raise InputError(f"projection '{projection}' of the transfer is unknown: update torchprt")
    wanted = output_order**2 - (projection == "reduced" and output_order > 1)
    if output_order < 1 or rows != wanted:
        raise InputError(
            f"{name} of the transfer has {rows} rows: output order {output_order} with the "
            f"projection '{projection}' has {wanted}"
        )
