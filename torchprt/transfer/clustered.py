"""Compressed transfer: the receivers of a cluster share an affine subspace and keep a few weights each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.glossy import GLOSSY_LAYOUTS, Layers, Projection
from torchprt.transfer.layout import Layout, check_finite, check_signal
from torchprt.transfer.provenance import Provenance

_LABELS = (torch.uint8, torch.int16, torch.int32, torch.int64)
_WHOLE = (torch.int32, torch.int64)


@dataclass
class ClusteredTransfer(Provenance):
    """Diffuse transfer vectors by clustered PCA.

    The vector of receiver v is `mean[k] + sum_i weights[v, i] basis[offsets[k] + i]`, k = `label[v]`, i below the count
    `offsets[k + 1] - offsets[k]` of its cluster. A light is applied to the K + E representatives and then weighted: the
    cost a receiver does not depend on the order. All else is as in `DiffuseTransfer`, which `compress.decompress` gives
    back.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 4 and 6.

    - `label [V]`, `weights [V, P]` (P the largest count of a cluster; zero from the count on), `mean [K, C, N]`,
      `basis [E, C, N]`, `offsets [K + 1]`.
    - `squared_error [V]`: what compression cost each receiver, summed over its coefficients; `compression_error`:
      RMS over all, relative to the transfer; `method`: how clusters were found.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "clustered"
    layouts: ClassVar[dict[str, Layout]] = {
        "positions": Layout(("V", "3"), (torch.float32, torch.float64)),
        "normals": Layout(("V", "3"), (torch.float32, torch.float64)),
        "faces": Layout(("F", "3"), _WHOLE),
        "albedo": Layout(("V|1", "3|1")),
        "label": Layout(("V",), _LABELS),
        "weights": Layout(("V", "P")),
        "mean": Layout(("K", "C", "N")),
        "basis": Layout(("E", "C", "N")),
        "offsets": Layout(("O",), _WHOLE),
        "squared_error": Layout(("V",)),
    }

    label: Tensor
    weights: Tensor
    mean: Tensor
    basis: Tensor
    offsets: Tensor
    squared_error: Tensor
    albedo: Tensor
    positions: Tensor
    normals: Tensor
    faces: Tensor
    method: str = "iterative"
    compression_error: float | None = None

    def __post_init__(self) -> None:
        check_signal(self)
        check_clusters(self)

    @property
    def order(self) -> int:
        """Number of SH bands."""
        return round(self.mean.shape[2] ** 0.5)

    @property
    def channels(self) -> int:
        return self.mean.shape[1]

    @property
    def vertices(self) -> int:
        """Number of receivers V."""
        return len(self.label)

    @property
    def bytes(self) -> int:
        """Bytes of labels, weights and representatives: what `DiffuseTransfer.bytes` was lowered to."""
        return cluster_bytes(self)

    def check(self) -> None:
        """Raises InputError if a tensor holds NaN or infinity, an albedo leaves [0, 1] or an index names nothing."""
        check_finite(self)
        check_labels(self)
        if self.albedo.numel() and (self.albedo.min() < 0 or self.albedo.max() > 1):
            raise InputError("albedo of the transfer is outside [0, 1]: bake it again")
        if self.faces.numel() and (self.faces.min() < 0 or self.faces.max() >= self.vertices):
            raise InputError("faces of the transfer name vertices that it does not have: bake it again")


@dataclass(kw_only=True)
class ClusteredGlossyTransfer(Layers):
    """Exit-radiance matrices by clustered PCA; the diffuse layer, if there is one, stays as it was.

    As `GlossyTransfer`, whose matrix of receiver `glossy[g]` is `mean[k] + sum_i weights[g, i] basis[offsets[k] + i]`,
    k = `label[g]`. A light is applied to the representatives, their exit coefficients are weighted, and the eye comes
    last.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 4 and 6.

    - `label [G]`, `weights [G, P]`, `mean [K, C, M, N]`, `basis [E, C, M, N]`, `offsets [K + 1]`, `squared_error [G]`,
      `compression_error`, `method`: as in `ClusteredTransfer`.
    - `output_order`, `projection`, `exit_error`: as in `GlossyTransfer`.

    Raises InputError if shapes or dtypes do not fit together; `check()` also looks at the values.
    """

    kind: ClassVar[str] = "clustered glossy"
    layouts: ClassVar[dict[str, Layout]] = GLOSSY_LAYOUTS | {
        "label": Layout(("G",), _LABELS),
        "weights": Layout(("G", "P")),
        "mean": Layout(("K", "C", "M", "N")),
        "basis": Layout(("E", "C", "M", "N")),
        "offsets": Layout(("O",), _WHOLE),
        "squared_error": Layout(("G",)),
    }

    label: Tensor
    weights: Tensor
    mean: Tensor
    basis: Tensor
    offsets: Tensor
    squared_error: Tensor
    output_order: int
    projection: Projection = "optimal"
    exit_error: float | None = None
    method: str = "iterative"
    compression_error: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_clusters(self)

    def _glossy_tensors(self) -> tuple[Tensor, ...]:
        return self.label, self.weights, self.mean, self.basis, self.offsets

    def check(self) -> None:
        """Raises InputError as the check of `GlossyTransfer`, and if a label names no cluster."""
        super().check()
        check_labels(self)


Clustered = ClusteredTransfer | ClusteredGlossyTransfer


def check_clusters(transfer: Clustered) -> None:
    """InputError unless there is an offset more than clusters."""
    if len(transfer.offsets) != len(transfer.mean) + 1:
        raise InputError(
            f"offsets of the transfer are {len(transfer.offsets)} for {len(transfer.mean)} clusters: one more is needed"
        )


def check_labels(transfer: Clustered) -> None:
    """InputError unless labels name clusters and offsets count their PCA vectors."""
    label, offsets = transfer.label.long(), transfer.offsets.long()
    if len(label) and (label.min() < 0 or label.max() >= len(transfer.mean)):
        raise InputError("label of the transfer names clusters that it does not have: compress it again")
    counts = offsets.diff()
    whole = int(offsets[0]) == 0 and int(offsets[-1]) == len(transfer.basis)
    if not whole or (len(counts) and (counts.min() < 0 or counts.max() > transfer.weights.shape[1])):
        raise InputError("offsets of the transfer do not count its PCA vectors: compress it again")


def cluster_bytes(transfer: Clustered) -> int:
    """Bytes of what stands for the signal."""
    parts = (transfer.label, transfer.weights, transfer.mean, transfer.basis, transfer.offsets)
    return sum(part.numel() * part.element_size() for part in parts)
