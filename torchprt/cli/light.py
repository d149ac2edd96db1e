"""`torchprt light`: an environment image to a light."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli.environments import WORDS, light_of
from torchprt.cli.report import say, triple
from torchprt.files import check_writable


def light(
    image: Annotated[
        str, typer.Argument(help=f"Latitude-longitude environment: .exr .hdr .png .jpg .tif; or {WORDS}.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help=".npy of order^2 x 3 coefficients.")],
    order: Annotated[int, typer.Option(min=1, max=64, help="SH bands.")] = 5,
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Project an environment image to a light."""
    check_writable(output, (".npy",))
    coefficients = light_of(image, order, repair)
    from torchprt.light import write_coefficients

    write_coefficients(coefficients, output)
    say(f"{output}: order {order}, mean radiance {triple(coefficients[0] / math.sqrt(4 * math.pi))}")
