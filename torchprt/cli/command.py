"""The command: its verbs, each in the file of its name, and how it ends."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable

import typer

from torchprt.cli.bake import bake
from torchprt.cli.bake_options import GroundCommand
from torchprt.cli.compress import compress
from torchprt.cli.demo import demo
from torchprt.cli.export import export
from torchprt.cli.fit import fit
from torchprt.cli.info import info
from torchprt.cli.lay import lay
from torchprt.cli.light import light
from torchprt.cli.patch import patch
from torchprt.cli.preview import preview
from torchprt.cli.render import render
from torchprt.cli.report import complain
from torchprt.cli.serve import serve
from torchprt.cli.shade import shade
from torchprt.errors import InputError

# In the order of `torchprt --help`.
VERBS: tuple[Callable[..., None], ...] = (
    bake,
    shade,
    light,
    export,
    serve,
    info,
    compress,
    fit,
    patch,
    lay,
    render,
    preview,
    demo,
)

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)
for verb in VERBS:
    app.command(cls=GroundCommand)(verb)


def main() -> None:
    """Runs the command. Faults of the input are one sentence on standard error and exit code 2."""
    with warnings.catch_warnings():
        # Without the file and the line of the code that warns.
        warnings.showwarning = lambda message, *_, **__: complain(message)
        try:
            app()
        except InputError as fault:
            complain(fault)
            sys.exit(2)
