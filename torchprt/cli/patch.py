"""`torchprt patch`: a relief to a map of zonal lobes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import options
from torchprt.cli.report import complain, describe, details, say
from torchprt.errors import InputError
from torchprt.files import check_writable

MESHES = (".ply", ".obj", ".glb", ".gltf", ".stl", ".off")


def patch(
    relief: Annotated[Path, typer.Argument(help="An image of heights, or a mesh over the unit square with z up.")],
    output: options.Output,
    depth: Annotated[
        float | None, typer.Option(help="Image: of white above black, in tiles.", show_default="0.1")
    ] = None,
    size: Annotated[int, typer.Option(min=2, max=1024, help="Texels a side.")] = 64,
    lobes: Annotated[int, typer.Option(min=1, max=64, help="Zonal lobes a texel.")] = 4,
    smooth: Annotated[bool, typer.Option("--smooth", help="Lobes of texels correspond: they interpolate.")] = False,
    order: Annotated[int, typer.Option(min=1, max=64, help="SH bands of the light that it will answer to.")] = 6,
    rays: Annotated[int, typer.Option(min=1, max=1 << 22, help="Rays a texel, over its hemisphere.")] = 1024,
    bounces: Annotated[str, typer.Option(help="How often light is reflected on: 0, 1, 2, ... or inf.")] = "0",
    albedo: Annotated[str | None, typer.Option(help="0.5, or r,g,b.", show_default="0.5, and 0 under a gloss")] = None,
    material: Annotated[str | None, typer.Option(help="A gloss: ggx:0.3,0.04, phong:40 or a .toml file.")] = None,
    specular: Annotated[str | None, typer.Option(help="Weight of the gloss: 0.5, or r,g,b.", show_default="1")] = None,
    factors: Annotated[
        str | None, typer.Option(help="Gloss: factors of view and light, a fit each: 4, or an error, 0.05.")
    ] = None,
    output_order: Annotated[
        int | None,
        typer.Option(min=1, max=32, help="Gloss: bands of exit radiance, without factors.", show_default="--order"),
    ] = None,
    subsurface: Annotated[
        str | None, typer.Option(help="Instead of an albedo a medium that light diffuses in: marble, skin1, ...")
    ] = None,
    millimetres: Annotated[float | None, typer.Option(help="Medium: how many mm a tile is wide.")] = None,
    thickness: Annotated[
        float | None,
        typer.Option(help="Medium: in tiles, where the patch is thinnest; light comes through.", show_default="opaque"),
    ] = None,
    single: Annotated[bool, typer.Option("--single", help="The patch does not tile: its border goes on.")] = False,
    unshadowed: Annotated[bool, typer.Option("--unshadowed", help="The closed form, without any ray.")] = False,
    threads: Annotated[int | None, typer.Option(min=1, help="As many as there are cores by default.")] = None,
) -> None:
    """Bake a small relief into a map of zonal lobes that any surface can be covered with."""
    from torchprt.scene import height_field, read_heights, read_mesh
    from torchprt.transfer import save
    from torchprt.transport import bake_patch
    from torchprt.transport.progress import Bar

    check_writable(output, (".safetensors",))
    count, colour = options.bounces(bounces), None if albedo is None else options.albedo(albedo)
    few, paint = options.factors(factors), options.material(material, specular)
    if paint is not None and len(paint.glosses) != 1:
        raise InputError(f"--material is '{material}', which is not one gloss: give one, as ggx:0.3,0.04")
    if paint is None and not (few is None and output_order is None):
        raise InputError("--factors and --output-order are of a gloss: give --material too")
    if relief.suffix.lower() in MESHES:
        if depth is not None:
            raise InputError(f"--depth is for images: {relief} has its own")
        mesh = read_mesh(relief)
    else:
        mesh = height_field(read_heights(relief), 0.1 if depth is None else depth, relief.name)
    start = time.perf_counter()
    try:
        with Bar() as bar:
            baked = bake_patch(
                mesh,
                size=size,
                lobes=lobes,
                smooth=smooth,
                tiles=not single,
                order=order,
                rays=rays,
                bounces=count,
                shadows=not unshadowed,
                albedo=colour,
                gloss=None if paint is None else paint.glosses[0],
                specular=1.0 if paint is None else paint.specular,
                factors=few,
                output_order=output_order,
                subsurface=subsurface,
                millimetres=millimetres,
                thickness=thickness,
                threads=threads,
                progress=bar,
            )
    except KeyboardInterrupt:
        complain("stopped; nothing is written")
        raise typer.Exit(130) from None
    save(baked, output)
    say(f"{output}: {describe(baked)}, baked in {time.perf_counter() - start:.1f} s")
    for line in details(baked):
        say(line)
