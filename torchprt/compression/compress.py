"""Compression to given sizes, to an error, or to a number of bytes."""

from __future__ import annotations

import os
from typing import Any, overload

from torch import Tensor

from torchprt.compression.checkpoint import Checkpoint
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.search import Sizes, candidates, corrected
from torchprt.compression.transfer import Method, check_kind, encode, other_bytes, signal_of, stored_signal
from torchprt.errors import InputError
from torchprt.progress import Report, Silent
from torchprt.transfer import (
    BakedTransfer,
    ClusteredFactoredTransfer,
    ClusteredGlossyTransfer,
    ClusteredIncidentTransfer,
    ClusteredTransfer,
    ClusteredVisibilityTransfer,
    CompressedTransfer,
    DiffuseTransfer,
    FactoredTransfer,
    GlossyTransfer,
    IncidentTransfer,
    Transfer,
    VisibilityTransfer,
)
from torchprt.version import VERSION

# Encodings until an error is met: each corrects what the next is expected to have.
_TRIES = 5


@overload
def compress(transfer: DiffuseTransfer, **options: Any) -> ClusteredTransfer: ...
@overload
def compress(transfer: GlossyTransfer, **options: Any) -> ClusteredGlossyTransfer: ...
@overload
def compress(transfer: FactoredTransfer, **options: Any) -> ClusteredFactoredTransfer: ...
@overload
def compress(transfer: IncidentTransfer, **options: Any) -> ClusteredIncidentTransfer: ...
@overload
def compress(transfer: VisibilityTransfer, **options: Any) -> ClusteredVisibilityTransfer: ...
@overload
def compress(transfer: Transfer, **options: Any) -> CompressedTransfer: ...
def compress(
    transfer: Transfer,
    *,
    clusters: int | None = None,
    components: int | None = None,
    error: float | None = None,
    bytes: int | None = None,
    method: Method = "iterative",
    bits: int = 32,
    shared: int | None = None,
    coherence: float | int = 0.0,
    iterations: int = 1,
    seed: int = 0,
    importance: Tensor | None = None,
    report: Report | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    keep: bool = False,
) -> CompressedTransfer:
    """Clustered PCA of what a bake stores of its receivers: vectors, matrices or visibility, by `clustered_pca`.

    A receiver keeps a label and a few weights; the representatives of its cluster are shared. The diffuse layer of
    glossy transfer stays as it is. How large the result is, is said in one of three ways:
    - `clusters` (256 if omitted), `components` (8) and `shared` (0): bases of two levels if that is above 0, every
      representative then being so many numbers in as many axes that all clusters share.
    - `bytes`: what `result.bytes` may be; of all sizes the one with the least error.
    - `error`: what `result.compression_error` may be; of all sizes that with the fewest bytes.
    The last two try clusters and components on a sample of receivers, and encode up to five times.

    - `bits`: of a weight. 32, or 16 and 8 with the representatives in half precision; with 8 every PCA vector has a
      range of its own.
    - `coherence`: error, as a part of the squared error, that may be added to lower the overdraw of the mesh.
    - `importance`: over the S numbers of one receiver, `[S]` or `[S, S]`, as for `clustered_pca`; `error` and what is
      stated are not weighed by it.
    - `report`, `checkpoint`: as for `clustered_pca`; the search for an error or a number of bytes goes on too. The file
      is removed when done unless it is to `keep` it (until the result is safe on disk, say).
    The result states what it cost: `squared_error` of every receiver and `compression_error`, relative RMS.

    Raises InputError as `clustered_pca`, if the transfer has no receivers or is of a kind without a compressed form, if
    sizes are given in more than one way, or if an error or a number of bytes cannot be met, with the best that can.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3.3, 4 and 5; the search is future work there.
    """
    whole = check_kind(transfer)
    if bits not in (8, 16, 32):
        raise InputError(f"bits is {bits}: weights are stored in 32, 16 or 8")
    if not coherence >= 0:
        raise InputError(f"coherence is {coherence}: it must be 0 or more, as 0.05 for 5 % more error")
    if error is not None and bytes is not None:
        raise InputError("error and bytes are both given: give one, the other is what comes of it")
    for name, value in (("clusters", clusters), ("components", components), ("shared", shared)):
        if value is not None and not (error is None and bytes is None):
            raise InputError(f"{name} is given, but is what is sought for an error or a number of bytes: leave it out")
    options: dict[str, Any] = {
        "method": method,
        "bits": bits,
        "coherence": float(coherence),
        "iterations": iterations,
        "seed": seed,
    }
    sizes = {"clusters": clusters, "components": components, "shared": shared, "error": error, "bytes": bytes}
    tensors = [stored_signal(whole), *([] if importance is None else [importance])]
    with Checkpoint(checkpoint, tensors, options | sizes | {"version": VERSION}, keep=keep) as store:
        options |= {"importance": importance, "passes": Passes(report or Silent(), store)}
        if error is not None or bytes is not None:
            return _sought(whole, error, bytes, options)
        clusters = (1 if method == "pca" else 256) if clusters is None else clusters
        components = (0 if method == "vq" else 8) if components is None else components
        return encode(whole, clusters, components, shared=shared or 0, **options)


def _sought(
    transfer: BakedTransfer, error: float | None, bytes: int | None, options: dict[str, Any]
) -> CompressedTransfer:
    """The sizes that meet an error or a number of bytes, one of which is given."""
    needed = {name: options[name] for name in ("method", "bits", "seed", "importance", "passes")}
    kept = other_bytes(transfer)
    # An error is seldom worth half of the bytes.
    limit = (transfer.bytes - kept) // 2 if bytes is None else bytes - kept
    sizes = candidates(signal_of(transfer), limit, **needed)
    if bytes is not None:
        return _within(transfer, sizes, bytes, kept, options)
    assert error is not None
    return _to(transfer, sizes, float(error), transfer.bytes - kept, options)


def _within(
    transfer: BakedTransfer, sizes: list[Sizes], bytes: int, kept: int, options: dict[str, Any]
) -> CompressedTransfer:
    """Of all `sizes` of at most so many bytes the one expected to have the least error."""
    limit = bytes - kept
    while True:
        fitting = [size for size in sizes if size.bytes <= limit]
        if not fitting:
            fewest = min(size.bytes for size in sizes) + kept
            raise InputError(
                f"bytes is {bytes}, which does not hold one cluster of {transfer.vertices} vertices: give "
                f"{fewest} or more, or fewer bits"
            )
        best = min(fitting, key=lambda size: (size.error, size.bytes))
        made = encode(transfer, best.clusters, best.components, shared=best.shared, **options)
        if made.bytes <= bytes:
            return made
        # Adaptive clusters have more PCA vectors than the mean: those of few points are cheap in weights.
        limit -= max(made.bytes - bytes, limit // 50 + 1)


def _to(
    transfer: BakedTransfer, sizes: list[Sizes], error: float, most: int, options: dict[str, Any]
) -> CompressedTransfer:
    """Of all `sizes` that have at most `error` the one with the fewest bytes, all below `most`."""
    if not error > 0:
        raise InputError(f"error is {error}: it must be above 0, as 0.01 for 1 % (relative RMS)")
    sizes = [size for size in sizes if size.bytes < most]
    if not sizes:
        raise InputError("the transfer is so small that one cluster takes more bytes: there is nothing to gain")
    found: CompressedTransfer | None = None
    tried: dict[Sizes, float] = {}
    expected = sizes
    for _ in range(_TRIES):
        fitting = [k for k, size in enumerate(expected) if size.error <= error and sizes[k] not in tried]
        if found is not None:
            fitting = [k for k in fitting if sizes[k].bytes < 0.97 * found.bytes]
        elif not fitting:
            # The least error there is, as the last word on what can be met.
            others = [k for k in range(len(sizes)) if sizes[k] not in tried]
            fitting = others and [min(others, key=lambda k: expected[k].error)]
        if not fitting:
            break
        k = min(fitting, key=lambda k: sizes[k].bytes)
        made = encode(transfer, sizes[k].clusters, sizes[k].components, shared=sizes[k].shared, **options)
        reached = made.compression_error or 0.0
        tried[sizes[k]] = reached
        if reached <= error and (found is None or made.bytes < found.bytes):
            found = made
        expected = corrected(sizes, sizes[k], reached)
    if found is None:
        raise InputError(
            f"error is {error:.3g}, which cannot be met in fewer bytes than the transfer itself: the best is "
            f"{min(tried.values()):.3g}, ask for that or for more bits"
        )
    return found
