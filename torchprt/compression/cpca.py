"""Clustered PCA: a signal as a few weights a point, in the affine subspace of the point's cluster."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float, Float64, Int64, Shaped
from torch import Tensor

from torchprt.compression.checkpoint import Checkpoint
from torchprt.compression.clustering_data import check, normalised
from torchprt.compression.clusters import PASSES, quantise
from torchprt.compression.importance import root_of, weighed
from torchprt.compression.refine import adapt, grow, surplus
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.subspaces import Advance, Subspaces, fit, groups, one_thread, pieces, silent
from torchprt.errors import InputError
from torchprt.progress import Report, Silent
from torchprt.version import VERSION

METHODS = ("iterative", "adaptive", "static", "pca", "vq")
# Passes of vector quantisation where others follow.
_START = 6


@dataclass(frozen=True, eq=False)
class ClusteredPca:
    """Points `x_p ~ mean_k + sum_i weights_pi basis_ki`, k the cluster of p, i below the cluster's count.

    - `label [V]`: the cluster of every point.
    - `mean [K, S]`, `basis [E, S]`: the representatives; those of cluster k are rows `offsets[k]` to `offsets[k + 1]`.
      PCA vectors are orthonormal (under the importance, if there was one), the most important first.
    - `weights [V, P]`: P is the largest count; zero from the count of the point's cluster on.
    - `error [V]`: squared error of every point, float64, of what is stored here; weighed, if there was an importance.
    """

    label: Int64[Tensor, "V"]
    mean: Float[Tensor, "K S"]
    basis: Float[Tensor, "E S"]
    offsets: Int64[Tensor, "K1"]
    weights: Float[Tensor, "V P"]
    error: Float64[Tensor, "V"]

    @property
    def counts(self) -> Tensor:
        """PCA vectors of every cluster, `[K]`."""
        return self.offsets.diff()

    @property
    def sizes(self) -> Tensor:
        """Points of every cluster, `[K]`."""
        return torch.bincount(self.label, minlength=len(self.mean))

    @property
    def cluster_error(self) -> Tensor:
        """Squared error of every cluster, `[K]` float64."""
        return torch.zeros_like(self.mean[:, 0], dtype=torch.float64).index_add_(0, self.label, self.error)

    def tensors(self) -> dict[str, Tensor]:
        """What a `transfer.Clustered` signal stores."""
        none = self.mean.new_zeros(0, dtype=torch.float32)
        return flat_tensors(self.label, self.offsets, self.weights) | {
            "mean": self.mean,
            "basis": self.basis,
            "low": none,
            "step": none,
        }

    def padded_basis(self) -> Tensor:
        """`[K, P, S]`: as many PCA vectors a cluster as the largest count, zero where there are none."""
        place = torch.arange(self.weights.shape[1], device=self.label.device)
        real = place < self.counts[:, None]
        padded = self.basis.new_zeros(*real.shape, self.mean.shape[1])
        padded[real] = self.basis
        return padded

    def reconstruct(self, points: Int64[Tensor, "n"] | None = None) -> Tensor:
        """The approximation of all points, `[V, S]`, or of some, in bounded temporary memory."""
        basis = self.padded_basis()
        label = self.label if points is None else self.label[points]
        weights = self.weights if points is None else self.weights[points]
        result = self.mean.new_empty(len(label), self.mean.shape[1])
        for chosen, some, real in groups(label, len(self.mean), self.mean.shape[1]):
            for rows, of in pieces(some, real, self.mean.shape[1]):
                result[rows[of]] = torch.baddbmm(self.mean[chosen, None], weights[rows], basis[chosen])[of]
        return result

    def check_data(self, data: Tensor) -> None:
        """InputError if this cannot have been made from `data`."""
        if self.label.shape != data.shape[:1] or self.mean.shape[1:] != data.shape[1:]:
            raise InputError(
                f"packed is of {len(self.label)} points of {self.mean.shape[1]} numbers, but data has shape "
                f"{tuple(data.shape)}: pass the data that it was made from"
            )

    def bytes(self, *, weight_bits: int = 32, representative_bits: int = 32) -> int:
        """Stored: a label and as many weights a point as its cluster has vectors, the representatives, the counts.

        The first term of the cost of section 4.1 of Sloan et al. 2003, m_p n', and the second, m_c (n' + 1) n, in
        bytes; a label takes one byte up to 256 clusters, two up to 65536, else four.
        """
        label = 1 if len(self.mean) <= 1 << 8 else 2 if len(self.mean) <= 1 << 16 else 4
        weights = int((self.sizes * self.counts).sum())
        representatives = self.mean.numel() + self.basis.numel()
        bits = weights * weight_bits + representatives * representative_bits
        return -(-bits // 8) + label * len(self.label) + 2 * len(self.mean)


def flat_tensors(
    label: Int64[Tensor, "V"], offsets: Int64[Tensor, "K1"], weights: Shaped[Tensor, "V P"]
) -> dict[str, Tensor]:
    """Labels and offsets as narrow as they may be, and the weights of one point after the other, without padding."""
    counts, clusters = offsets.diff(), len(offsets) - 1
    real = torch.arange(weights.shape[1], device=weights.device) < counts[label, None]
    narrow = torch.uint8 if clusters <= 1 << 8 else torch.int16 if clusters <= 1 << 15 else torch.int32
    return {"label": label.to(narrow), "weights": weights[real], "offsets": offsets.to(torch.int32)}


def clustered_pca(
    data: Float[Tensor, "V S"],
    clusters: int,
    components: int,
    *,
    method: Literal["iterative", "adaptive", "static", "pca", "vq"] = "iterative",
    iterations: int = 1,
    seed: int = 0,
    importance: Tensor | None = None,
    report: Report | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> ClusteredPca:
    """Every point of `data` as a cluster and `components` weights.

    - "static": vector quantisation, then PCA in every cluster.
    - "iterative": points go to the cluster that approximates them best, not to the one whose mean is nearest, and
      PCA follows every such pass. Components are added one by one, with `iterations` passes each, and up to six times
      as many follow at the end. There are twice as many clusters at first; those that are missed least are dropped.
    - "adaptive": then clusters with much error take PCA vectors from those with little. `components` is the mean
      number of weights a point; no cluster has more than `4 * components + 4`.
    - "vq": no components. "pca": one cluster. All methods are the same there; the names only say what is meant.

    `importance` `[S]` or `[S, S]`: the squared error of a difference d is `d . (importance * d)` or
    `d @ importance @ d`. It says how much a coefficient is expected to matter, as the second moments of the light, and
    must be positive (definite): what never matters would be lost.

    `report` is told of every stage in points: so many passes over all of them, or fewer if they settle before.
    `checkpoint`: a file that keeps the clusters after a pass, at most every ten seconds and on Ctrl-C; the same call
    goes on from there, to the same bits, and removes it when done. One of other data or parameters is not used, with a
    `CheckpointWarning`.

    Signals of more than 128 numbers are clustered in their 128 principal axes; means and PCA vectors are then fitted
    in full. Up to that width "adaptive" is never worse than "iterative" from the same seed. Means, Gram matrices and
    eigenvectors are computed in float64, the rest in the dtype of `data`. Same seed, same bits, however many threads
    torch has.

    Raises InputError if there are more clusters than points, fewer than 0 or more than S components, a number that is
    not finite, an importance that is not positive, or a checkpoint that is another file or cannot be written.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3.3 and 4.
    """
    parameters: dict[str, object] = {
        "clusters": clusters,
        "components": components,
        "method": method,
        "iterations": iterations,
        "seed": seed,
        "version": VERSION,
    }
    with Checkpoint(checkpoint, [data, *([] if importance is None else [importance])], parameters) as store:
        passes = Passes(report or Silent(), store)
        return pack(data, clusters, components, method, iterations, seed, importance, passes)


def pack(
    data: Tensor,
    clusters: int,
    components: int,
    method: str,
    iterations: int,
    seed: int,
    importance: Tensor | None,
    passes: Passes,
) -> ClusteredPca:
    """`clustered_pca`, its passes told and kept as `passes` says."""
    _check(data, clusters, components, method)
    check(data, clusters, iterations)
    with torch.no_grad(), one_thread():
        root = None if importance is None else root_of(importance, data)
        metric = data if root is None else weighed(data, root)
        found = passes.result()
        if not found:
            label, counts = _clusters(normalised(metric), clusters, components, method, iterations, seed, passes)
            found = {"label": label, "counts": counts}
            passes.finish(**found)
        label, counts = found["label"], found["counts"]
        with passes.stage("weights", 2, len(data)) as stage:
            spaces = fit(metric, label, clusters, int(counts.max()), stage.advance)
            spaces.counts = counts
            return project(data, label, spaces, root, stage.advance)


def _clusters(
    points: Tensor, clusters: int, components: int, method: str, iterations: int, seed: int, passes: Passes
) -> tuple[Tensor, Tensor]:
    """Labels `[V]` and numbers of PCA vectors `[K]`, from all passes."""
    refined = clusters > 1 and components > 0 and method in ("iterative", "adaptive")
    started = surplus(len(points), clusters) if refined else clusters
    label = quantise(points, started, seed, _START if refined else PASSES, passes)
    counts = torch.full((clusters,), components, device=label.device)
    if refined:
        label = grow(points, label, clusters, min(components, points.shape[1]), iterations, passes)
        if method == "adaptive":
            label, counts = adapt(points, label, clusters, components, 12 * iterations, passes)
    return label, counts


def _check(data: Tensor, clusters: int, components: int, method: str) -> None:
    if method not in METHODS:
        raise InputError(f"method is '{method}': choose one of {', '.join(METHODS)}")
    if components < 0:
        raise InputError(f"components is {components}: it must be 0 (vector quantisation) or more")
    if components > data.shape[-1]:
        raise InputError(
            f"components is {components}, but a point has only {data.shape[-1]} numbers: ask for no more than that"
        )
    if method == "vq" and components != 0:
        raise InputError(f"components is {components}: vector quantisation has none, pass 0 or another method")
    if method == "pca" and clusters != 1:
        raise InputError(f"clusters is {clusters}: plain PCA has one, pass 1 or another method")


def project(
    data: Tensor, label: Tensor, spaces: Subspaces, root: Tensor | None = None, advance: Advance = silent
) -> ClusteredPca:
    """Weights and error of every point; representatives back from under the importance."""
    clusters, rows, width = spaces.basis.shape
    kept = torch.arange(rows, device=label.device) < spaces.counts[:, None]
    mean, basis = spaces.mean, spaces.basis * kept[:, :, None]
    measure = basis
    if root is not None:
        mean = torch.linalg.solve(root, mean, left=False)
        basis = torch.linalg.solve(root, basis.flatten(0, 1), left=False).view_as(basis)
        measure = measure @ root.mT
    mean, basis = mean.to(data.dtype), basis.to(data.dtype)
    weights = data.new_zeros(len(data), rows)
    error = data.new_zeros(len(data), dtype=torch.float64)
    for chosen, points, real in groups(label, clusters, width):
        for some, of in pieces(points, real, width):
            centred = data[some].double() - mean[chosen, None].double()
            found = (centred @ measure[chosen].mT).to(data.dtype)
            residual = torch.baddbmm(centred, found.double(), basis[chosen].double(), alpha=-1)
            residual = residual if root is None else residual @ root
            weights[some[of]] = found[of]
            error[some[of]] = residual.square().sum(2)[of]
            advance(int(of.sum()))
    offsets = torch.cat([spaces.counts.new_zeros(1), spaces.counts.cumsum(0)])
    return ClusteredPca(label, mean, basis[kept], offsets, weights, error)
