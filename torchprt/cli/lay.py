"""`torchprt lay`: a patch laid on a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import options
from torchprt.cli.report import describe, details, say
from torchprt.errors import InputError
from torchprt.files import check_writable


def lay(
    map: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt patch` wrote.")],
    mesh: Annotated[Path, typer.Argument(help="A mesh with texture coordinates.")],
    output: options.Output,
    repeat: Annotated[str, typer.Option(help="Patches from 0 to 1 along u,v.")] = "1,1",
) -> None:
    """Cover a mesh with a patch: transfer that turns with the surface when it bends."""
    from torchprt import shade as room
    from torchprt import transfer as kinds
    from torchprt.scene import read_mesh

    check_writable(output, (".safetensors",))
    u, v = options.numbers(repeat, 2, "--repeat")
    baked = kinds.load(map)
    surface = read_mesh(mesh)
    if surface.uv is None:
        raise InputError(f"{mesh} has no texture coordinates: unwrap it (a patch is laid on through them)")
    arrays = (surface.positions.float(), surface.faces.int(), surface.uv)
    laid = room.lay(baked, *arrays, repeat=(u, v), normals=surface.normals)
    kinds.save(laid, output)
    say(f"{output}: {describe(laid)}")
    for line in details(laid)[1:]:
        say(line)
