"""The command: its verbs, each in the file of its name, and how it ends."""

from __future__ import annotations

import functools
import inspect
import os
import sys
import warnings
from collections.abc import Callable
from typing import Annotated, Any

import typer

from torchprt.cli.bake import bake
from torchprt.cli.bake_options import GroundCommand
from torchprt.cli.cast import cast
from torchprt.cli.completion import completed
from torchprt.cli.compress import compress
from torchprt.cli.demo import demo
from torchprt.cli.export import export
from torchprt.cli.fit import fit
from torchprt.cli.info import info
from torchprt.cli.lay import lay
from torchprt.cli.light import light
from torchprt.cli.neighbourhood import neighbourhood
from torchprt.cli.patch import patch
from torchprt.cli.plan import plan
from torchprt.cli.preview import preview
from torchprt.cli.render import render
from torchprt.cli.report import answer, complain, unheard
from torchprt.cli.resting import resting
from torchprt.cli.serve import serve
from torchprt.cli.shade import shade
from torchprt.cli.tradeoff import tradeoff
from torchprt.cli.volume import volume
from torchprt.errors import InputError
from torchprt.files import NO_ROOM
from torchprt.progress import QUIET, quiet
from torchprt.version import VERSION

# In the order of `torchprt --help`.
VERBS: tuple[Callable[..., None], ...] = (
    bake,
    shade,
    light,
    export,
    serve,
    info,
    tradeoff,
    compress,
    plan,
    fit,
    patch,
    lay,
    neighbourhood,
    cast,
    volume,
    render,
    preview,
    demo,
)

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _hushed(asked: bool) -> bool:
    if asked:
        # A variable, because it also holds for workers; `main` takes it back.
        os.environ[QUIET] = "1"
    return asked


def _version(asked: bool | None) -> None:
    if asked:
        answer(f"torchprt {VERSION}")
        raise typer.Exit


Quiet = Annotated[
    bool,
    typer.Option(
        "-q", "--quiet", callback=_hushed, help=f"Tell nothing but faults; as the environment variable {QUIET}=1."
    ),
]


@app.callback(help="Precomputed radiance transfer: bake meshes once, light them in real time, export them.")
def _options(
    version: Annotated[
        bool | None, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = None,
    quiet: Quiet = False,
) -> None: ...


def _with_common_options(verb: Callable[..., None]) -> Callable[..., None]:
    """A verb with the options that all have, whose words Tab completes."""

    @functools.wraps(verb)
    def run(*arguments: Any, quiet: bool, **options: Any) -> None:
        verb(*arguments, **options)

    signature = completed(verb)
    common = inspect.Parameter("quiet", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Quiet)
    run.__signature__ = signature.replace(parameters=[*signature.parameters.values(), common])  # type: ignore[attr-defined]
    return run


for verb in VERBS:
    app.command(cls=GroundCommand)(_with_common_options(verb))


def main() -> None:
    """Runs the command. Faults of the input are one sentence on standard error and exit code 2."""
    before = os.environ.get(QUIET)
    try:
        with warnings.catch_warnings(), resting():
            # Without the file and the line of the code that warns.
            warnings.showwarning = lambda message, *_, **__: None if quiet() else complain(message)
            app()
    except InputError as fault:
        complain(fault)
        sys.exit(2)
    except OSError as fault:
        # Usage and help are printed by a library.
        if fault.filename is not None or fault.errno not in NO_ROOM:
            raise
        complain(unheard(fault))
        sys.exit(2)
    finally:
        os.environ.pop(QUIET, None)
        os.environ.update({} if before is None else {QUIET: before})
