"""`torchprt volume`: a grid of density to what its cells scatter."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchprt.cli import bake_options, options
from torchprt.cli.report import details, say
from torchprt.files import check_writable
from torchprt.suffixes import VOLUMES
from torchprt.words import either

if TYPE_CHECKING:
    from torchprt.transfer import Transfer

GRID, BAKE = "Grid", bake_options.BAKE


def volume(
    grid: Annotated[Path, typer.Argument(help=f"A grid of density: {either(VOLUMES)}.")],
    output: options.Output,
    scale: Annotated[
        float, typer.Option(rich_help_panel=GRID, help="What makes extinction, a unit of length, of its density.")
    ] = 1.0,
    albedo: Annotated[
        str | None,
        typer.Option(
            rich_help_panel=GRID, help="Share of light that is scattered: 0.99, or r,g,b.", show_default="file, or 1"
        ),
    ] = None,
    phase: Annotated[
        str | None,
        typer.Option(
            rich_help_panel=GRID,
            help="Mean cosine of its scattering, 0 in all directions alike, clouds 0.85; or Legendre moments 1,g1,g2.",
            show_default="file, or 0",
        ),
    ] = None,
    spacing: Annotated[
        str | None,
        typer.Option(rich_help_panel=GRID, help="Size of a cell: 0.1, or X,Y,Z.", show_default="file, or 1"),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(rich_help_panel=GRID, help="Its lowest corner X,Y,Z.", show_default="file, or 0,0,0"),
    ] = None,
    coarsen: Annotated[
        int, typer.Option(min=1, rich_help_panel=GRID, help="Take the mean of so many cells along each axis.")
    ] = 1,
    name: Annotated[
        str | None,
        typer.Option(
            "--grid",
            rich_help_panel=GRID,
            help="Which one of a .vdb or .nvdb.",
            show_default="the only one, or density",
        ),
    ] = None,
    blocker: bake_options.Blocker = None,
    order: bake_options.Order = None,
    output_order: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=BAKE, min=1, max=64, help="Bands of what arrives in a cell.", show_default="as --order"
        ),
    ] = None,
    rays: Annotated[
        int,
        typer.Option(rich_help_panel=BAKE, min=1, max=1 << 22, help="Directions that all cells are swept along."),
    ] = 4096,
    bounces: Annotated[
        str,
        typer.Option(
            rich_help_panel=BAKE,
            help="How often light is scattered again: 0, 1, 2, ..., inf, or auto: until a pass adds less than 1 %.",
        ),
    ] = bake_options.BOUNCES,
    seed: bake_options.Seed = None,
    threads: bake_options.CPUs = None,
    cluster: bake_options.OnCluster = None,
    checkpoint: bake_options.At = None,
    half: Annotated[bool, typer.Option("--half", help="Store transfer in float16.")] = False,
) -> None:
    """Bake how a cloud or smoke shades itself and scatters light. Surfaces stand below it by `torchprt bake --volume`.

    A grid is an .npy of density [X, Y, Z], an .npz of arrays by name, a .nvdb or a .vdb: see docs/volumes.md.
    """
    check_writable(output, (".safetensors",))
    count = options.bounces(bounces)
    found: dict[str, Any] = {
        "albedo": None if albedo is None else options.colour(albedo, "--albedo"),
        "phase": None if phase is None else _one_or(options.numbers(phase, None, "--phase")),
        "spacing": None if spacing is None else _one_or(options.numbers(spacing, None, "--spacing")),
        "origin": None if origin is None else options.numbers(origin, 3, "--origin"),
    }

    from torchprt.scene import load_objects, read_volume
    from torchprt.transport import bake_volume

    read = read_volume(grid, scale=scale, coarsen=coarsen, grid=name, **found)
    say(f"{grid}: {read}")

    def make(folder: Path | str | None) -> Transfer:
        return bake_volume(
            read,
            blockers=load_objects((), blockers=blocker or ()),
            order=order or bake_options.ORDER,
            output_order=output_order,
            rays=rays,
            bounces=count,
            seed=seed or 0,
            threads=threads,
            on=cluster,
            checkpoint=folder,
            keep=True,
        )

    baked = bake_options.kept(output, make, half=half, at=checkpoint)
    for line in details(baked):
        say(line)


def _one_or(numbers: list[float]) -> float | list[float]:
    """One number by itself, several as they are."""
    return numbers[0] if len(numbers) == 1 else numbers
