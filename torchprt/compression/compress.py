"""Compression to given sizes, to an error, or to a number of bytes."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

from torch import Tensor

from torchprt.compression.checkpoint import Checkpoint
from torchprt.compression.resumable_passes import Passes
from torchprt.compression.sampled import encode_sampled, enough, is_sampled, sample_of
from torchprt.compression.search import Sizes, candidates, corrected
from torchprt.compression.transfer import Method, encode, faces_between, layer_to_compress, numbers_of
from torchprt.errors import InputError
from torchprt.progress import Report, Silent
from torchprt.transfer import Clustered, Dense, Transfer
from torchprt.version import VERSION

# Of clusters, components and options, the clustered signal.
Make = Callable[..., Clustered]
# Encodings until an error is met: each corrects what the next is expected to have.
_TRIES = 5
# Of the error that is asked for: as much is near enough.
_NEAR = 0.93


def compress(
    transfer: Transfer,
    *,
    layer: str | None = None,
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
    sample: int | None = None,
) -> Transfer:
    """Clustered PCA of what a bake stores of a layer: vectors, matrices or visibility, by `clustered_pca`.

    A receiver keeps a label and a few weights; the representatives of its cluster are shared. `layer`: which one, the
    last if omitted; the others stay as they are. How large the result is, is said in one of three ways:
    - `clusters` (256 if omitted), `components` (8) and `shared` (0): bases of two levels if that is above 0, every
      representative then being so many numbers in as many axes that all clusters share.
    - `bytes`: what `result.bytes` may be; of all sizes the one with the least error.
    - `error`: what `compression_error` of its signal may be; of all sizes that with the fewest bytes.
    The last two try clusters and components on a sample of receivers, and encode up to five times, until the error is
    at most 7 % below what was asked for.

    - `bits`: of a weight. 32, or 16 and 8 with the representatives in half precision; with 8 every PCA vector has a
      range of its own.
    - `coherence`: error, as a part of the squared error, that may be added to lower the overdraw of the mesh.
    - `importance`: over the S numbers of one receiver, `[S]` or `[S, S]`, as for `clustered_pca`; `error` and what is
      stated are not weighed by it.
    - `report`, `checkpoint`: as for `clustered_pca`; the search for an error or a number of bytes goes on too. The file
      is removed when done unless it is to `keep` it (until the result is safe on disk, say).
    - `sample`: find clusters from so many receivers, drawn evenly over all. In passes over all receivers, some at a
      time, means and PCA vectors are then fitted to all of them, each goes to the cluster that is nearest to it,
      whatever the method, and gets its best weights. So a transfer that `load` mapped need not fit into memory: what
      stands there is the sample and what is stored of a receiver. By itself, with a `SampledWarning`, where all
      receivers do not fit: 512 a cluster, and 65536 at least. The same seed and sample are the same bits; errors are
      those of all receivers. `coherence` takes all of them.
    The signal of the result states what it cost: `squared_error` of every receiver and `compression_error`, relative
    RMS.

    Raises InputError as `clustered_pca`, if the sample holds fewer receivers than clusters, the layer has no receivers,
    is compressed already or is none, if sizes are given in more than one way, or if an error or a number of bytes
    cannot be met, with the best that can.
    Source: Sloan, Hall, Hart and Snyder 2003, sections 3.3, 4 and 5; the search is future work there.
    """
    name, chosen, whole = layer_to_compress(transfer, layer)
    if bits not in (8, 16, 32):
        raise InputError(f"bits is {bits}: weights are stored in 32, 16 or 8")
    if not coherence >= 0:
        raise InputError(f"coherence is {coherence}: it must be 0 or more, as 0.05 for 5 % more error")
    if error is not None and bytes is not None:
        raise InputError("error and bytes are both given: give one, the other is what comes of it")
    for size, value in (("clusters", clusters), ("components", components), ("shared", shared)):
        if value is not None and not (error is None and bytes is None):
            raise InputError(f"{size} is given, but is what is sought for an error or a number of bytes: leave it out")
    sampled = is_sampled(whole, sample, float(coherence))
    options: dict[str, Any] = {
        "method": method,
        "bits": bits,
        "iterations": iterations,
        "seed": seed,
    }
    options |= {"sample": sample} if sampled else {"coherence": float(coherence)}
    sizes = {"clusters": clusters, "components": components, "shared": shared, "error": error, "bytes": bytes}
    tensors = [whole.values, *([] if importance is None else [importance])]
    with Checkpoint(checkpoint, tensors, options | sizes | {"version": VERSION}, keep=keep) as store:
        options |= {"importance": importance, "passes": Passes(report or Silent(), store)}
        make = partial(encode_sampled, whole) if sampled else partial(encode, whole, faces_between(transfer, chosen))
        if error is not None or bytes is not None:
            # Bytes and errors that are given and told are of all layers.
            kept = transfer.bytes - chosen.signal.bytes
            made = _sought(whole, make, kept, error, bytes, options)
        else:
            clusters = (1 if method == "pca" else 256) if clusters is None else clusters
            components = (0 if method == "vq" else 8) if components is None else components
            made = make(clusters, components, shared=shared or 0, **options)
    return transfer.with_layers(**{name: chosen.replace(signal=made)})


def foretell(
    transfer: Transfer,
    points: int,
    *,
    layer: str | None = None,
    method: Method = "iterative",
    bits: int = 32,
    seed: int = 0,
) -> list[Sizes]:
    """The sizes that `compress` seeks among, where `transfer` is a sample of `points` receivers of its layer.

    Their bytes are those of the layer of all receivers, exact; their errors, relative RMS, are expected ones.
    Raises InputError as `compress`.
    """
    _, _, whole = layer_to_compress(transfer, layer)
    signal = numbers_of(whole)
    limit = 4 * points * signal.shape[1]
    return candidates(signal, limit, method=method, bits=bits, seed=seed, passes=Passes(), points=points)


def _sought(
    dense: Dense,
    make: Make,
    kept: int,
    error: float | None,
    bytes: int | None,
    options: dict[str, Any],
) -> Clustered:
    """The sizes that meet an error or a number of bytes, one of which is given; `kept`: bytes that stay as they are."""
    needed = {name: options[name] for name in ("method", "bits", "seed", "importance", "passes")}
    # An error is seldom worth half of the bytes.
    limit = dense.bytes // 2 if bytes is None else bytes - kept
    receivers = dense.shape[0]
    if "sample" in options:
        # Sizes are tried on a part of it.
        signal = sample_of(dense, min(receivers, options["sample"] or enough(0)), options["seed"])
    else:
        signal = numbers_of(dense)
    sizes = candidates(signal, limit, error=error, points=receivers, **needed)
    if bytes is not None:
        return _within(dense, make, sizes, bytes, kept, options)
    assert error is not None
    return _to(dense, make, sizes, float(error), options)


def _within(dense: Dense, make: Make, sizes: list[Sizes], bytes: int, kept: int, options: dict[str, Any]) -> Clustered:
    """Of all `sizes` of at most so many bytes the one expected to have the least error."""
    limit = bytes - kept
    while True:
        fitting = [size for size in sizes if size.bytes <= limit]
        if not fitting:
            fewest = min(size.bytes for size in sizes) + kept
            raise InputError(
                f"bytes is {bytes}, which does not hold one cluster of {dense.shape[0]} vertices: give "
                f"{fewest} or more, or fewer bits"
            )
        best = min(fitting, key=lambda size: (size.error, size.bytes))
        made = make(best.clusters, best.components, shared=best.shared, **options)
        if made.bytes + kept <= bytes:
            return made
        # Adaptive clusters have more PCA vectors than the mean: those of few points are cheap in weights.
        limit -= max(made.bytes + kept - bytes, limit // 50 + 1)


def _to(dense: Dense, make: Make, sizes: list[Sizes], error: float, options: dict[str, Any]) -> Clustered:
    """Of all `sizes` that have at most `error` the one with the fewest bytes, all below those of `dense`."""
    if not error > 0:
        raise InputError(f"error is {error}: it must be above 0, as 0.01 for 1 % (relative RMS)")
    sizes = [size for size in sizes if size.bytes < dense.bytes]
    if not sizes:
        raise InputError("the transfer is so small that one cluster takes more bytes: there is nothing to gain")
    found: Clustered | None = None
    tried: dict[Sizes, float] = {}
    expected = sizes
    for _ in range(_TRIES):
        if found is not None and _NEAR * error <= (found.compression_error or 0.0):
            # What is left to gain is less than another encoding takes.
            break
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
        made = make(sizes[k].clusters, sizes[k].components, shared=sizes[k].shared, **options)
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
