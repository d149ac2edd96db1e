"""Glossy transfer: what a receiver sends toward the eye is a matrix, because it depends on the eye."""

from __future__ import annotations

import abc
import dataclasses
from dataclasses import dataclass
from typing import ClassVar, Literal, TypeVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.layout import Layout, check_finite, check_signal
from torchprt.transfer.provenance import Provenance

Projection = Literal["optimal", "reduced", "zero", "odd", "even"]

_REAL = (torch.float32, torch.float64)
_WHOLE = (torch.int32, torch.int64)

GLOSSY_LAYOUTS = {
    "positions": Layout(("V", "3"), _REAL),
    "normals": Layout(("V", "3"), _REAL),
    "faces": Layout(("F", "3"), _WHOLE),
    "albedo": Layout(("V|1", "3|1")),
    "glossy": Layout(("G",), _WHOLE),
    "tangents": Layout(("G", "3"), _REAL),
    "specular": Layout(("G|1", "3|1")),
    "diffuse": Layout(("C", "N", "V|0")),
}


@dataclass(kw_only=True)
class Layers(Provenance, abc.ABC):
    """What all kinds of glossy transfer share: where the receivers are, and their diffuse layer.

    - `positions [V, 3]`, `normals [V, 3]`, `faces [F, 3]`, `albedo`: as in `DiffuseTransfer`.
    - `diffuse [C, N, V or 0]`: transfer vectors of the diffuse layer, as in `DiffuseTransfer`; none if nothing is
      diffuse.
    - `glossy [G]`: the receivers that have a glossy layer, ascending. All below is about them.
    - `tangents [G, 3]`: unit, orthogonal to the normals. The rows tangent, normal x tangent, normal are the local
      frame of a receiver: local = frame @ world.
    - `specular [G or 1, 3 or 1]`: weight of the glossy layer, in [0, 1], applied at run time like the albedo.
    - `materials`: the reflectance of the glossy layers, as text.
    - `transport`, `bounces`, `rays`, `seed`, `version`: as in `DiffuseTransfer`; `error` and `signal` are of the
      glossy layer.
    """

    kind: ClassVar[str]
    layouts: ClassVar[dict[str, Layout]]

    positions: Tensor
    normals: Tensor
    faces: Tensor
    albedo: Tensor
    glossy: Tensor
    tangents: Tensor
    specular: Tensor
    diffuse: Tensor
    materials: list[str] = dataclasses.field(default_factory=list)

    def __post_init__(self) -> None:
        check_signal(self)

    @property
    def order(self) -> int:
        """Number of SH bands of the light."""
        return round(self.diffuse.shape[1] ** 0.5)

    @property
    def channels(self) -> int:
        return self.diffuse.shape[0]

    @property
    def vertices(self) -> int:
        """Number of receivers V."""
        return len(self.positions)

    @property
    def bytes(self) -> int:
        """Bytes of the transfer alone, diffuse and glossy, which is what compression lowers."""
        return sum(value.numel() * value.element_size() for value in (self.diffuse, *self._glossy_tensors()))

    @abc.abstractmethod
    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        """What the glossy layer is stored in."""

    def check(self) -> None:
        """Raises InputError if a tensor holds NaN or infinity, a weight leaves [0, 1], or an index names no vertex."""
        check_finite(self)
        for name in ("albedo", "specular"):
            value = getattr(self, name)
            if value.numel() and (value.min() < 0 or value.max() > 1):
                raise InputError(f"{name} of the transfer is outside [0, 1]: bake it again")
        for name in ("faces", "glossy"):
            value = getattr(self, name)
            if value.numel() and (value.min() < 0 or value.max() >= self.vertices):
                raise InputError(f"{name} of the transfer name vertices that it does not have: bake it again")
        if len(self.glossy) > 1 and not bool((self.glossy[1:] > self.glossy[:-1]).all()):
            raise InputError("glossy of the transfer must name vertices in ascending order, each once: bake it again")

    def _fewer(self, order: int) -> int:
        if not 1 <= order <= self.order:
            raise InputError(f"order {order} is not between 1 and the {self.order} that the transfer has")
        return order * order


@dataclass(kw_only=True)
class GlossyTransfer(Layers):
    """Exit-radiance matrices of glossy receivers, with the BRDF baked in.

    The glossy layer of receiver `glossy[g]` sends `specular * sum_i e_i(v) sum_j matrix[:, g, i, j] l_j` toward the
    local direction v under a light `l [N, 3]` of the world; e_i are `sh.exit_functions(v, output_order, projection)`.
    Laws: linear in the light; the first bands of N answer to a light of lower order.
    Source: Sloan, Hall, Hart and Snyder 2003, section 3, equation 1.

    - `matrix [C, G, M, N]`: one channel unless light bounced off coloured surfaces. Any float dtype.
    - `output_order`: of the exit functions; `projection`: which they are.
    - `exit_error`: what the exit functions cannot represent of the materials, unshadowed, under lights that are
      white over N; relative RMS, the worst material's.
    The rest is described at `DiffuseTransfer` and shared by the kinds of glossy transfer: `positions`, `normals`,
    `faces`, `albedo`, `diffuse [C, N, V or 0]` (vectors of the diffuse layer), `glossy [G]` (receivers that have a
    glossy layer, ascending), `tangents [G, 3]` (unit; the local frame is tangent, normal x tangent, normal),
    `specular [G or 1, 3 or 1]` (weight of the glossy layer, applied at run time), `materials` (as text).

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "glossy"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | {"matrix": Layout(("C", "G", "M", "N"))}

    matrix: Tensor
    output_order: int
    projection: Projection = "optimal"
    exit_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_rows("matrix", self.matrix.shape[2], self.output_order, self.projection)

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return (self.matrix,)

    def to_order(self, order: int) -> GlossyTransfer:
        """For lights of the first `order` bands. Raises InputError unless 1 <= order <= self.order."""
        return _columns(self, self._fewer(order))

    def to(self, dtype: torch.dtype) -> GlossyTransfer:
        """The same with vectors and matrices stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        return dataclasses.replace(self, matrix=self.matrix.to(dtype), diffuse=self.diffuse.to(dtype))


@dataclass(kw_only=True)
class FactoredTransfer(Layers):
    """Exit-radiance matrices of few rows: the BRDF is factored into functions of the eye and of the light.

    As `GlossyTransfer`, with `u_i(v)` in place of e_i: `factors [M, H, H]` holds them at the texels of an equal-area
    map of the hemisphere, read bilinearly (`brdf.sample_hemisphere_map`). One BRDF for all glossy receivers.
    `factor_error`: relative RMS of unshadowed exit radiance that the M products leave out, under lights that are
    white over N. Shadows make sharper light, of which they leave out more.
    Source: Sloan, Luna and Snyder 2005, section 5.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "factored"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | {
        "matrix": Layout(("C", "G", "M", "N")),
        "factors": Layout(("M", "H", "H"), _REAL),
    }

    matrix: Tensor
    factors: Tensor
    factor_error: float | None = None

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return self.matrix, self.factors

    def to_order(self, order: int) -> FactoredTransfer:
        """For lights of the first `order` bands. Raises InputError unless 1 <= order <= self.order."""
        return _columns(self, self._fewer(order))

    def to(self, dtype: torch.dtype) -> FactoredTransfer:
        """The same with vectors and matrices stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        return dataclasses.replace(self, matrix=self.matrix.to(dtype), diffuse=self.diffuse.to(dtype))


@dataclass(kw_only=True)
class IncidentTransfer(Layers):
    """Source to transferred incident radiance: the BRDF is chosen at run time.

    Under a light `l [N, 3]` of the world the radiance that arrives at receiver `glossy[g]` from the local direction s,
    zero below the horizon, has the SH coefficients `sum_j matrix[:, g, i, j] l_j`, i < `output_order`^2.
    Source: Sloan, Kautz and Snyder 2002, section 4.2, equation 12, with the rows in the local frame as T'_p in Sloan,
    Hall, Hart and Snyder 2003, section 7.

    - `matrix [C, G, M, N]`, M = `output_order`^2. `materials` are those that other surfaces see when light bounces.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "incident"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | {"matrix": Layout(("C", "G", "M", "N"))}

    matrix: Tensor

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = self.matrix.shape[2]
        if rows == 0 or self.output_order**2 != rows:
            raise InputError(f"matrix of the transfer has {rows} rows: it must be the square of the output order")

    @property
    def output_order(self) -> int:
        """Number of SH bands of transferred incident radiance."""
        return round(self.matrix.shape[2] ** 0.5)

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return (self.matrix,)

    def to_order(self, order: int) -> IncidentTransfer:
        """For lights of the first `order` bands. Raises InputError unless 1 <= order <= self.order."""
        return _columns(self, self._fewer(order))

    def to(self, dtype: torch.dtype) -> IncidentTransfer:
        """The same with vectors and matrices stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        return dataclasses.replace(self, matrix=self.matrix.to(dtype), diffuse=self.diffuse.to(dtype))


@dataclass(kw_only=True)
class VisibilityTransfer(Layers):
    """Visibility alone, multiplied with the light at run time: a vector a receiver instead of a matrix.

    The visibility of receiver `glossy[g]` in the local direction s is about `sum_k visibility[k, g] h_k(s)`,
    h = `sh.hemisphere_basis(s, visibility_order)`. At the nodes s_d and weights w_d of
    `sh.gauss_legendre_hemisphere(degree)` it meets the light turned into the local frame; exit coefficients are
    `sum_d kernel[i, d] V(s_d) L(s_d)`, the weights are in `kernel [M, D]`, and exit radiance is
    `specular * sum_i e_i(v) ...` as in `GlossyTransfer`. One BRDF for all glossy receivers; shadows only.
    Source: Sloan, Kautz and Snyder 2002, section 4.2 (the product of light and visibility on the fly).

    - `visibility [I, G]`, I = `visibility_order`^2; `kernel [M, D]`; `degree`, `output_order`, `projection`.
    - `product_error`: what truncated visibility costs, relative RMS of exit radiance, estimated on some receivers.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "visibility"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | {
        "visibility": Layout(("I", "G")),
        "kernel": Layout(("M", "D"), _REAL),
    }

    visibility: Tensor
    kernel: Tensor
    degree: int
    output_order: int
    projection: Projection = "optimal"
    exit_error: float | None = None
    product_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        count = self.visibility.shape[0]
        if count == 0 or self.visibility_order**2 != count:
            raise InputError(f"visibility of the transfer has {count} coefficients: it must be the square of its order")
        _check_rows("kernel", self.kernel.shape[0], self.output_order, self.projection)
        nodes = (self.degree // 2 + 1) * (self.degree + 1)
        if self.kernel.shape[1] != nodes:
            raise InputError(
                f"kernel of the transfer has {self.kernel.shape[1]} nodes: the rule of degree {self.degree} has {nodes}"
            )

    @property
    def visibility_order(self) -> int:
        """Number of bands of visibility."""
        return round(self.visibility.shape[0] ** 0.5)

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return self.visibility, self.kernel

    def to_order(self, order: int) -> VisibilityTransfer:
        """For lights of the first `order` bands. Raises InputError unless 1 <= order <= self.order."""
        return dataclasses.replace(self, diffuse=self.diffuse[:, : self._fewer(order)].contiguous())

    def to(self, dtype: torch.dtype) -> VisibilityTransfer:
        """The same with diffuse vectors and visibility stored as `dtype` (float16 and bfloat16 halve the bytes)."""
        return dataclasses.replace(self, visibility=self.visibility.to(dtype), diffuse=self.diffuse.to(dtype))


T = TypeVar("T", GlossyTransfer, FactoredTransfer, IncidentTransfer)


def _check_rows(name: str, rows: int, output_order: int, projection: str) -> None:
    if projection not in ("optimal", "reduced", "zero", "odd", "even"):
        raise InputError(f"projection '{projection}' of the transfer is unknown: update torchprt")
    wanted = output_order**2 - (projection == "reduced" and output_order > 1)
    if output_order < 1 or rows != wanted:
        raise InputError(
            f"{name} of the transfer has {rows} rows: output order {output_order} with the "
            f"projection '{projection}' has {wanted}"
        )


def _columns(transfer: T, count: int) -> T:
    matrix = transfer.matrix[..., :count].contiguous()
    return dataclasses.replace(transfer, matrix=matrix, diffuse=transfer.diffuse[:, :count].contiguous())
