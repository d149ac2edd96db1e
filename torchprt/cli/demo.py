"""`torchprt demo`: the demonstration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli.report import say


def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for what it makes.")] = Path("demo"),
) -> None:
    """Bake, relight and export the project's own samples; write pictures of all of it."""
    from torchprt.demo import run

    run(output, say)
