"""`torchprt fit`: transfer to zonal lobes, which follow a surface that deforms."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import options
from torchprt.cli.report import complain, describe, details, say
from torchprt.files import check_writable


def fit(
    transfer: Annotated[Path, typer.Argument(help="Diffuse or factored, as `torchprt bake` wrote it.")],
    output: options.Output,
    lobes: Annotated[int, typer.Option(min=1, max=64, help="Zonal lobes a vertex, or a row of gloss.")] = 4,
    smooth: Annotated[bool, typer.Option("--smooth", help="Lobes of neighbours correspond: they interpolate.")] = False,
    smoothness: Annotated[
        float | None,
        typer.Option(help="How much they do, at what it costs of the fit; implies --smooth.", show_default="0.03"),
    ] = None,
    restarts: Annotated[int, typer.Option(min=0, help="Times to start anew, from random axes.")] = 0,
    seed: Annotated[int, typer.Option(min=0, help="Of random axes.")] = 0,
) -> None:
    """Fit zonal lobes to a bake: transfer that turns with a surface that bends."""
    from torchprt import compression as room
    from torchprt import transfer as kinds
    from torchprt.transport.progress import Bar

    check_writable(output, (".safetensors",))
    loaded = kinds.load(transfer)
    asked = {} if smoothness is None else {"smoothness": smoothness}
    start = time.perf_counter()
    try:
        with Bar() as bar:
            fitted = room.fit(
                loaded,
                lobes=lobes,
                smooth=smooth or smoothness is not None,
                restarts=restarts,
                seed=seed,
                report=bar,
                **asked,
            )
    except KeyboardInterrupt:
        complain("stopped; nothing is written")
        raise typer.Exit(130) from None
    taken = time.perf_counter() - start
    kinds.save(fitted, output)
    say(f"{output}: {describe(fitted)}, fitted in {taken:.1f} s")
    for line in details(fitted)[1:]:
        say(line)
