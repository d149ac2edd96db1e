"""Clustered PCA in fewer bytes: representatives in half precision, weights in one or two bytes."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Float64, Int64
from torch import Tensor

from torchprt.compression.clustering_data import check
from torchprt.compression.cpca import ClusteredPca, flat_tensors
from torchprt.compression.importance import root_of
from torchprt.compression.subspaces import groups, one_thread, pieces
from torchprt.errors import InputError

_LEVELS = 255
# Float16 is exact to 11 bits from here to its largest number.
_SMALLEST, _LARGEST = 2.0**-14, 65504.0


@dataclass(frozen=True, eq=False)
class QuantisedPca:
    """A `ClusteredPca` whose weights are `low_k + step_k * code_p`, k the cluster of p.

    - `label [V]`, `mean [K, S]`, `basis [E, S]`, `offsets [K + 1]`: as there, mean and basis float16.
    - `code [V, P]`: uint8, with a range for every PCA vector of every cluster, `low [E]` and `step [E]` float32; or
      float16, the weight itself (low 0, step 1).
    - `error [V]`: squared error of every point, float64, of what is stored here.
    """

    label: Int64[Tensor, "V"]
    mean: Float[Tensor, "K S"]
    basis: Float[Tensor, "E S"]
    offsets: Int64[Tensor, "K1"]
    code: Tensor
    low: Float[Tensor, "E"]
    step: Float[Tensor, "E"]
    error: Float64[Tensor, "V"]

    def restore(self) -> ClusteredPca:
        """The same in float32, for shading and whatever else takes a `ClusteredPca`."""
        place = torch.arange(self.code.shape[1], device=self.label.device)
        real = (place < self.offsets.diff()[:, None])[self.label]
        rows = self.offsets[:-1][self.label, None] + place
        weights = torch.zeros(self.code.shape, dtype=torch.float32, device=self.label.device)
        weights[real] = self.low[rows[real]] + self.step[rows[real]] * self.code[real].float()
        return ClusteredPca(self.label, self.mean.float(), self.basis.float(), self.offsets, weights, self.error)

    def tensors(self) -> dict[str, Tensor]:
        """As `ClusteredPca.tensors`, with the ranges of weights of one byte."""
        one = self.code.dtype == torch.uint8
        ranges = {name: getattr(self, name)[: None if one else 0] for name in ("low", "step")}
        flat = flat_tensors(self.label, self.offsets, self.code)
        return flat | ranges | {"mean": self.mean, "basis": self.basis}

    def bytes(self) -> int:
        """As `ClusteredPca.bytes`, and for weights of one byte their ranges."""
        one = self.code.dtype == torch.uint8
        plain = self.restore().bytes(weight_bits=8 if one else 16, representative_bits=16)
        return plain + (8 * len(self.low) if one else 0)


def quantise(
    data: Float[Tensor, "V S"], packed: ClusteredPca, *, bits: int = 8, importance: Tensor | None = None
) -> QuantisedPca:
    """`packed` with representatives in float16 and weights in `bits` 8 or 16.

    Weights are the best for the rounded representatives before they are rounded themselves. In 8 bits each PCA vector
    of each cluster has 256 levels from the least to the greatest of its weights. `data` and `importance` are those
    that `packed` was made from.

    Raises InputError for other bits, if data and packed do not belong together, or if the signal is too large or too
    small for float16.
    """
    if bits not in (8, 16):
        raise InputError(f"bits is {bits}: weights are stored in 8 or 16")
    check(data, 1, 1)
    packed.check_data(data)
    check_half(packed)
    with torch.no_grad(), one_thread():
        root = None if importance is None else root_of(importance, data)
        stored = ClusteredPca(
            packed.label, packed.mean.half(), packed.basis.half(), packed.offsets, packed.weights, packed.error
        )
        weights = best_weights(data, stored, root)
        code, low, step = _rounded(weights, packed, bits)
        quantised = QuantisedPca(
            packed.label, stored.mean, stored.basis, packed.offsets, code, low, step, torch.zeros_like(packed.error)
        )
        restored = quantised.restore()
        for rows in torch.arange(len(data), device=data.device).split(1 << 14):
            difference = data[rows].double() - restored.reconstruct(rows).double()
            difference = difference if root is None else difference @ root
            quantised.error[rows] = difference.square().sum(1)
        return quantised


def check_half(packed: ClusteredPca) -> None:
    """InputError if float16 does not hold it."""
    for name, value in (("mean", packed.mean), ("weights", packed.weights), ("basis", packed.basis)):
        most = float(value.abs().amax()) if value.numel() else 0.0
        if most > _LARGEST or 0 < most < _SMALLEST:
            raise InputError(f"{name} of packed reaches {most:.3g}, which float16 does not hold: scale the data")


def best_weights(data: Tensor, stored: ClusteredPca, root: Tensor | None) -> Tensor:
    """Least-squares weights `[V, P]` float64 for representatives that are no longer orthonormal."""
    basis, mean = stored.padded_basis().double(), stored.mean.double()
    measure = basis if root is None else basis @ root @ root.mT
    products = measure @ basis.mT
    # Rows that there are not: a weight of zero.
    missing = products.diagonal(dim1=1, dim2=2) == 0
    products = products + missing.double().diag_embed()
    weights = data.new_zeros(len(data), basis.shape[1], dtype=torch.float64)
    for chosen, points, real in groups(stored.label, len(mean), data.shape[1]):
        for some, of in pieces(points, real, data.shape[1]):
            along = (data[some].double() - mean[chosen, None]) @ measure[chosen].mT
            weights[some[of]] = torch.linalg.solve(products[chosen], along, left=False)[of]
    return weights


def _rounded(weights: Tensor, packed: ClusteredPca, bits: int) -> tuple[Tensor, Tensor, Tensor]:
    """Codes `[V, P]`, and what they count from and by, `[E]`."""
    clusters, rows = len(packed.mean), weights.shape[1]
    kept = torch.arange(rows, device=weights.device) < packed.counts[:, None]
    if bits == 16:
        low = torch.zeros(len(packed.basis), device=weights.device)
        return weights.half(), low, torch.ones_like(low)
    of = packed.label[:, None].expand(-1, rows)
    bound = weights.new_zeros(clusters, rows)
    least = bound.scatter_reduce(0, of, weights, "amin", include_self=False)
    most = bound.scatter_reduce(0, of, weights, "amax", include_self=False)
    low, step = range_of(least, most)
    return counted(weights, packed.label, low, step), low[kept], step[kept]


def range_of(least: Tensor, most: Tensor) -> tuple[Tensor, Tensor]:
    """What codes count from and by, `[K, P]` float32, for weights between these, float64."""
    low = least.float()
    return low, ((most - low) / _LEVELS).float()


def counted(weights: Tensor, label: Tensor, low: Tensor, step: Tensor) -> Tensor:
    """Codes `[V, P]` of weights, by the ranges `[K, P]`."""
    levels = (weights - low[label]) / step[label].clamp(min=torch.finfo(torch.float32).tiny)
    return levels.round().clamp(0, _LEVELS).to(torch.uint8)
