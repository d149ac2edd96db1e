"""`torchprt compress`: transfer to less of it."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import options
from torchprt.cli.environments import light_of
from torchprt.cli.one_bar import OneBar
from torchprt.cli.report import complain, describe, details, say
from torchprt.errors import InputError
from torchprt.files import check_writable

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.transfer import Transfer

_UNITS = {"": 1, "K": 2**10, "M": 2**20, "G": 2**30}


def compress(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    output: options.Output,
    layer: Annotated[
        str | None, typer.Option(help="Which: diffuse, exit, ...; the others stay.", show_default="the last")
    ] = None,
    clusters: Annotated[
        int | None, typer.Option(min=1, help="How many groups of vertices.", show_default="256")
    ] = None,
    components: Annotated[int | None, typer.Option(min=0, help="Weights a vertex.", show_default="8")] = None,
    error: Annotated[
        str | None, typer.Option(help="In place of these: the error to keep to, 0.01 or 1% (relative RMS).")
    ] = None,
    bytes: Annotated[str | None, typer.Option(help="In place of these: the bytes to keep to, 500K or 4M.")] = None,
    method: Annotated[str, typer.Option(help="iterative, adaptive, static, pca or vq.")] = "iterative",
    bits: Annotated[int, typer.Option(help="Of a weight: 32, or 16 or 8 with representatives in half precision.")] = 32,
    shared: Annotated[
        int | None, typer.Option(min=1, help="Axes that all clusters share: bases of two levels.", show_default="none")
    ] = None,
    coherence: Annotated[str, typer.Option(help="Error to add for clusters in one piece: 0.05 or 5%.")] = "0",
    superclusters: Annotated[
        int | None,
        typer.Option(min=1, help="Order the mesh by clusters, so many in a supercluster.", show_default="as baked"),
    ] = None,
    importance: Annotated[
        str | None,
        typer.Option(help="What light to expect: natural, or .npy, images and built-in lights.", show_default="any"),
    ] = None,
    sample: Annotated[
        int | None,
        typer.Option(
            min=1, help="Find clusters from so many receivers, as for large files.", show_default="all that fit"
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the clusters to start from.")] = 0,
) -> None:
    """Compress a bake by clustered PCA: a few weights a vertex instead of its vector or matrix.

    Stopped with Ctrl-C, the same command goes on.
    """
    from torchprt import compression as room
    from torchprt import transfer as kinds
    from torchprt.transport.progress import Bar

    check_writable(output, (".safetensors",))
    chosen = options.choice(method, "--method", options.METHODS)
    target = None if error is None else fraction(error, "--error")
    size = None if bytes is None else byte_count(bytes, "--bytes")
    added = fraction(coherence, "--coherence")
    loaded = kinds.load(transfer)
    weight = None if importance is None else expected(importance, loaded, layer)
    partial = output.with_name(output.name + ".partial")
    start = time.perf_counter()
    try:
        with Bar(rates=False) as bar:
            told = OneBar(bar, "compress", searching=target is not None or size is not None)
            packed = room.compress(
                loaded,
                layer=layer,
                clusters=clusters,
                components=components,
                error=target,
                bytes=size,
                method=chosen,
                bits=bits,
                shared=shared,
                coherence=added,
                importance=weight,
                seed=seed,
                report=told,
                checkpoint=partial,
                keep=True,
                sample=sample,
            )
            told.end()
        if superclusters is not None:
            packed = room.reorder(packed, superclusters)
        taken = time.perf_counter() - start
        kinds.save(packed, output)
    except KeyboardInterrupt:
        kept = f"; {partial} keeps what is done, the same command goes on from there" if partial.exists() else ""
        complain(f"stopped{kept}")
        raise typer.Exit(130) from None
    partial.unlink(missing_ok=True)
    say(f"{output}: {describe(packed)}, compressed in {taken:.1f} s")
    for line in details(packed)[1:]:
        say(line)
    say(f"{loaded.bytes / packed.bytes:.1f} times smaller")


def fraction(text: str, option: str) -> float:
    """`0.05` or `5%`; InputError unless it is zero or more."""
    part, percent = text.strip(), text.strip().endswith("%")
    try:
        value = float(part.removesuffix("%")) / (100 if percent else 1)
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise InputError(f"{option} is '{text}': give a part as 0.05 or 5%")
    return value


def byte_count(text: str, option: str) -> int:
    """`4000000`, `500K`, `4M`, `1.5G`."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)([KMG]?)B?", text.strip(), re.IGNORECASE)
    if found is None:
        raise InputError(f"{option} is '{text}': give bytes as 4000000, 500K or 4M")
    return int(float(found[1]) * _UNITS[found[2].upper()])


def expected(text: str, transfer: Transfer, layer: str | None) -> Tensor:
    """The importance over the numbers of one receiver: of the spectrum of natural light, or of files of lights."""
    import torch

    from torchprt.compression import light_importance, natural_light_importance
    from torchprt.compression.transfer import layer_to_compress

    _, chosen, _ = layer_to_compress(transfer, layer)
    if not chosen.meets_light:
        raise InputError(
            f"--importance is given, but no light is applied to {chosen.kind} as it is stored: leave it out"
        )
    _, channels, rows, _ = chosen.signal.shape
    if text == "natural":
        return natural_light_importance(transfer.order, channels=channels, rows=rows)
    lights = [light_of(name, transfer.order) for name in text.split(",")]
    return light_importance(torch.stack(lights).float(), channels=channels, rows=rows)
