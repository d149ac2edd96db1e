"""`torchprt serve`: a page in the browser of this machine."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli.report import answer


def serve(
    folder: Annotated[Path, typer.Argument(help="A folder that `torchprt export --web` wrote.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 for one that is free.")] = 8000,
) -> None:
    """Show a page on this machine, at 127.0.0.1, until Ctrl-C."""
    from torchprt.web import serve as served

    with served(folder, port) as server:
        answer(f"{folder} is at http://127.0.0.1:{server.server_port}/ until Ctrl-C")
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()
