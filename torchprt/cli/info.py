"""`torchprt info`: what files hold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli.contents import contents
from torchprt.cli.report import answer, complain
from torchprt.errors import InputError


def info(
    file: Annotated[
        list[Path],
        typer.Argument(
            help="Transfers, .prt, .pca, meshes, images, lights, .npy, .toml, .onnx, pages, stopped bakes, .mp4."
        ),
    ],
) -> None:
    """Say what files hold."""
    faults = 0
    for number, path in enumerate(file):
        if number:
            answer("")
        try:
            for line in contents(path):
                answer(line)
        except InputError as fault:
            complain(fault)
            faults += 1
    if faults:
        raise typer.Exit(2)
