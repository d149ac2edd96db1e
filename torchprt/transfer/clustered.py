"""Compressed transfer: the receivers of a cluster share an affine subspace and keep a few weights each."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.glossy import GLOSSY_LAYOUTS, Layers, Projection
from torchprt.transfer.layout import FLOATS, Layout, check_finite, check_signal
from torchprt.transfer.provenance import Provenance

_LABELS = (torch.uint8, torch.int16, torch.int32, torch.int64)
_WHOLE = (torch.int32, torch.int64)


def _cluster_layouts(points: str, *signal: str) -> dict[str, Layout]:
    return {
        "label": Layout((points,), _LABELS),
        "weights": Layout(("W",), (*FLOATS, torch.uint8)),
        "mean": Layout(("K", "Q")),
        "basis": Layout(("E", "Q")),
        "shared": Layout(("Q|0", *signal)),
        "offsets": Layout(("O",), _WHOLE),
        "low": Layout(("E|0",)),
        "step": Layout(("E|0",)),
        "squared_error": Layout((points,)),
        "original": Layout(("V|0",), _WHOLE),
    }


@dataclass(kw_only=True)
class Clusters:
    """What all kinds of clustered transfer share: a signal of S numbers a receiver, as a cluster and a few weights.

    The signal of a receiver is `mean[k] + sum_i w_i basis[offsets[k] + i]`, k its label, i below the count
    `offsets[k + 1] - offsets[k]` of its cluster.

    - `label`: the cluster of every receiver. `weights [W]`: those of the first receiver, of the second, ..., each as
      many as its cluster has PCA vectors.
    - `mean [K, Q]`, `basis [E, Q]`: representatives, `offsets [K + 1]`. Q = S, or, with bases of two levels, Q numbers
      that stand for `q @ shared`, `shared [Q, ...]` being axes that all clusters share; else `shared` has no rows, and
      its other sizes say what the S numbers are.
    - `low [E]`, `step [E]`: if weights are bytes, those of vector e are `low[e] + step[e] * byte`; else empty.
    - `squared_error`: what compression cost each receiver, summed over its numbers; `compression_error`: RMS over
      all, relative to the transfer; `method`: how clusters were found.
    - `original [V or 0]`: which vertex of the mesh every one was, if `compress.reorder` put them in another order.
    Source: Sloan, Hall, Hart and Snyder 2003, section 4.
    """

    label: Tensor
    weights: Tensor
    mean: Tensor
    basis: Tensor
    shared: Tensor
    offsets: Tensor
    low: Tensor
    step: Tensor
    squared_error: Tensor
    original: Tensor = field(default_factory=lambda: torch.zeros(0, dtype=torch.int64))
    method: str = "iterative"
    compression_error: float | None = None

    @property
    def counts(self) -> Tensor:
        """PCA vectors of every cluster, `[K]`."""
        return self.offsets.long().diff()

    def blend(self, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
        """Rows of `basis` and their weights, `[W]` both, and where those of every receiver start."""
        label = self.label.long()
        count = self.counts[label]
        starts = count.cumsum(0) - count
        place = torch.arange(len(self.weights), device=label.device) - starts.repeat_interleave(count)
        rows = self.offsets.long()[label].repeat_interleave(count) + place
        weights = self.weights.to(dtype)
        if self.weights.dtype == torch.uint8:
            weights = torch.addcmul(self.low.to(dtype)[rows], self.step.to(dtype)[rows], weights)
        return rows, weights, starts

    def representatives(self, dtype: torch.dtype) -> Tensor:
        """Means, then PCA vectors, `[K + E, Q]`."""
        return torch.cat([self.mean, self.basis]).detach().to(dtype)

    def cluster_error(self) -> Tensor:
        """Squared error of every cluster, `[K]` float64."""
        total = torch.zeros(len(self.mean), dtype=torch.float64, device=self.label.device)
        return total.index_add_(0, self.label.long(), self.squared_error.double())

    def _cluster_tensors(self) -> tuple[Tensor, ...]:
        return self.label, self.weights, self.mean, self.basis, self.shared, self.offsets, self.low, self.step

    def _check_shapes(self) -> None:
        if len(self.offsets) != len(self.mean) + 1:
            raise InputError(
                f"offsets of the transfer are {len(self.offsets)} for {len(self.mean)} clusters: one more is needed"
            )
        numbers = math.prod(self.shared.shape[1:])
        if not len(self.shared) and self.mean.shape[1] != numbers:
            raise InputError(
                f"mean of the transfer has {self.mean.shape[1]} numbers for a signal of {numbers}: without shared axes "
                "they must be the same"
            )
        ranges = len(self.basis) if self.weights.dtype == torch.uint8 else 0
        if len(self.low) != ranges or len(self.step) != ranges:
            raise InputError(
                f"low and step of the transfer have {len(self.low)} and {len(self.step)} entries: weights of "
                f"{str(self.weights.dtype).removeprefix('torch.')} take {ranges}"
            )

    def mesh_order(self, values: Tensor) -> Tensor:
        """`values [..., V, 3]` of the vertices in the order that they have in the mesh."""
        return values[..., self.original.argsort(), :] if len(self.original) else values

    def _check_labels(self) -> None:
        label, offsets, counts = self.label.long(), self.offsets.long(), self.counts
        if len(label) and (label.min() < 0 or label.max() >= len(self.mean)):
            raise InputError("label of the transfer names clusters that it does not have: compress it again")
        whole = int(offsets[0]) == 0 and int(offsets[-1]) == len(self.basis)
        if not whole or (len(counts) and counts.min() < 0):
            raise InputError("offsets of the transfer do not count its PCA vectors: compress it again")
        order = self.original
        if len(order) and not torch.equal(order.sort().values.long(), torch.arange(len(order), device=order.device)):
            raise InputError("original of the transfer does not name every vertex once: compress it again")
        if int(counts[label].sum()) != len(self.weights):
            raise InputError(
                f"weights of the transfer are {len(self.weights)}, but its receivers have {int(counts[label].sum())}: "
                "compress it again"
            )


@dataclass(kw_only=True)
class ClusteredTransfer(Clusters, Provenance):
    """Diffuse transfer vectors by clustered PCA.

    A light is applied to the K + E representatives and then weighted: the cost a receiver does not depend on the
    order. All else is as in `DiffuseTransfer`, which `compress.decompress` gives back.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 4 and 6.

    - `label [V]`, `squared_error [V]`, `shared [Q or 0, C, N]`, and the rest: see `Clusters`.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "clustered"
    layouts: ClassVar[dict[str, Layout]] = {
        "positions": Layout(("V", "3"), (torch.float32, torch.float64)),
        "normals": Layout(("V", "3"), (torch.float32, torch.float64)),
        "faces": Layout(("F", "3"), _WHOLE),
        "albedo": Layout(("V|1", "3|1")),
        **_cluster_layouts("V", "C", "N"),
    }

    albedo: Tensor
    positions: Tensor
    normals: Tensor
    faces: Tensor

    def __post_init__(self) -> None:
        check_signal(self)
        self._check_shapes()

    @property
    def order(self) -> int:
        """Number of SH bands."""
        return round(self.shared.shape[2] ** 0.5)

    @property
    def channels(self) -> int:
        return self.shared.shape[1]

    @property
    def vertices(self) -> int:
        """Number of receivers V."""
        return len(self.label)

    @property
    def bytes(self) -> int:
        """Bytes of labels, weights and representatives: what `DiffuseTransfer.bytes` was lowered to."""
        return sum(part.numel() * part.element_size() for part in self._cluster_tensors())

    def check(self) -> None:
        """Raises InputError if a tensor holds NaN or infinity, an albedo leaves [0, 1] or an index names nothing."""
        check_finite(self)
        self._check_labels()
        if self.albedo.numel() and (self.albedo.min() < 0 or self.albedo.max() > 1):
            raise InputError("albedo of the transfer is outside [0, 1]: bake it again")
        if self.faces.numel() and (self.faces.min() < 0 or self.faces.max() >= self.vertices):
            raise InputError("faces of the transfer name vertices that it does not have: bake it again")


@dataclass(kw_only=True)
class ClusteredLayers(Clusters, Layers):
    """Glossy transfer whose glossy layer is compressed; the diffuse layer, if there is one, stays as it was.

    `label [G]`, `squared_error [G]`, `shared [Q or 0, C, M, N]`; else as `Clusters` and `Layers`.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_shapes()

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return self._cluster_tensors()

    def check(self) -> None:
        """Raises InputError as the check of `GlossyTransfer`, and if a label names no cluster."""
        super().check()
        self._check_labels()


@dataclass(kw_only=True)
class ClusteredGlossyTransfer(ClusteredLayers):
    """Exit-radiance matrices by clustered PCA.

    As `GlossyTransfer`, with the matrices `[C, M, N]` of the glossy receivers as the signal of `Clusters`. A light is
    applied to the representatives, their exit coefficients are weighted, and the eye comes last.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 4 and 6.

    - `output_order`, `projection`, `exit_error`: as in `GlossyTransfer`.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "clustered glossy"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | _cluster_layouts("G", "C", "M", "N")

    output_order: int
    projection: Projection = "optimal"
    exit_error: float | None = None


@dataclass(kw_only=True)
class ClusteredFactoredTransfer(ClusteredLayers):
    """As `ClusteredGlossyTransfer`, of the matrices of `FactoredTransfer`, whose `factors` stay as they were."""

    kind: ClassVar[str] = "clustered factored"
    layouts: ClassVar[dict[str, Layout]] = (
        GLOSSY_LAYOUTS | _cluster_layouts("G", "C", "M", "N") | {"factors": Layout(("M", "H", "H"))}
    )

    factors: Tensor
    factor_error: float | None = None

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return *self._cluster_tensors(), self.factors


@dataclass(kw_only=True)
class ClusteredIncidentTransfer(ClusteredLayers):
    """As `ClusteredGlossyTransfer`, of the matrices of `IncidentTransfer`: the BRDF is chosen at run time."""

    kind: ClassVar[str] = "clustered incident"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | _cluster_layouts("G", "C", "M", "N")

    @property
    def output_order(self) -> int:
        """Number of SH bands of transferred incident radiance."""
        return round(self.shared.shape[2] ** 0.5)


@dataclass(kw_only=True)
class ClusteredVisibilityTransfer(ClusteredLayers):
    """Visibility by clustered PCA: the vectors `[I]` of `VisibilityTransfer`, `shared [Q or 0, I]`.

    Bytes are gained, not time: the product with the light is in the frame of every receiver.
    """

    kind: ClassVar[str] = "clustered visibility"
    layouts: ClassVar[dict[str, Layout]] = (
        GLOSSY_LAYOUTS | _cluster_layouts("G", "I") | {"kernel": Layout(("M", "D"), (torch.float32, torch.float64))}
    )

    kernel: Tensor
    degree: int
    output_order: int
    projection: Projection = "optimal"
    exit_error: float | None = None
    product_error: float | None = None

    @property
    def visibility_order(self) -> int:
        """Number of bands of visibility."""
        return round(self.shared.shape[1] ** 0.5)

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return *self._cluster_tensors(), self.kernel
