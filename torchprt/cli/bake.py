"""`torchprt bake`: meshes to transfer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import options
from torchprt.cli.report import complain, describe, details, say
from torchprt.files import check_writable


def bake(
    mesh: Annotated[list[Path], typer.Argument(help="Meshes that receive light: .ply .obj .glb .gltf .stl .off .usd")],
    output: options.Output,
    order: Annotated[int, typer.Option(min=1, max=64, help="SH bands of the light that it will answer to.")] = 5,
    rays: Annotated[int, typer.Option(min=1, max=1 << 22, help="Rays a vertex, over its hemisphere.")] = 1024,
    bounces: Annotated[str, typer.Option(help="How often light is reflected on: 0, 1, 2, ... or inf.")] = "0",
    albedo: Annotated[
        str | None,
        typer.Option(help="0.5, or r,g,b, or vertex for the colours in the file.", show_default="0.5, under a gloss 0"),
    ] = None,
    material: Annotated[
        str | None,
        typer.Option(help="phong:40 blinn:40 ggx:0.3 ggx:0.3,0.04 ward:0.1,0.4 membrane:0.5 or a .toml file."),
    ] = None,
    specular: Annotated[str | None, typer.Option(help="Weight of the gloss: 0.5, or r,g,b.")] = None,
    two_sided: Annotated[bool, typer.Option("--two-sided", help="Surfaces reflect with both sides.")] = False,
    blocker: Annotated[list[Path] | None, typer.Option(help="A mesh that only casts shadows (repeatable).")] = None,
    unshadowed: Annotated[bool, typer.Option("--unshadowed", help="The closed form, without any ray.")] = False,
    seed: Annotated[int, typer.Option(min=0, help="Turns the set of directions.")] = 0,
    threads: Annotated[int | None, typer.Option(min=1, help="As many as there are cores by default.")] = None,
    half: Annotated[bool, typer.Option("--half", help="Store transfer in float16.")] = False,
    frame: Annotated[
        str, typer.Option(help="Gloss: exit (baked in), incident (chosen later) or visibility (the least memory).")
    ] = "exit",
    output_order: Annotated[
        int | None, typer.Option(min=1, max=32, help="Gloss: bands toward the eye.", show_default="as --order")
    ] = None,
    visibility_order: Annotated[
        int | None, typer.Option(min=1, max=32, help="Gloss: bands of --frame visibility.", show_default="as --order")
    ] = None,
    projection: Annotated[
        str, typer.Option(help="Gloss: onto the bands: optimal, reduced, zero, odd or even.")
    ] = "optimal",
    factors: Annotated[
        str | None, typer.Option(help="Gloss: factors of view and light instead of bands: 4, or an error, 0.05.")
    ] = None,
) -> None:
    """Bake how meshes shadow and light themselves. Stopped with Ctrl-C, the same command goes on."""
    import shutil
    import time

    import torch

    import torchprt as prt
    from torchprt.transport import bake as baked

    check_writable(output, (".safetensors",))
    count, colour, few = options.bounces(bounces), options.albedo(albedo), options.factors(factors)
    kind = options.choice(frame, "--frame", options.FRAMES)
    onto = options.choice(projection, "--projection", options.PROJECTIONS)
    surface = options.material(material, specular)
    scene = prt.load(mesh, albedo=colour, two_sided=two_sided, blockers=blocker or (), material=surface)
    say(scene)
    folder = output.with_name(output.name + ".partial")
    start = time.perf_counter()
    try:
        transfer = baked(
            scene,
            order=order,
            rays=rays,
            bounces=count,
            shadows=not unshadowed,
            seed=seed,
            threads=threads,
            checkpoint=None if unshadowed else folder,
            keep=True,
            frame=kind,
            output_order=output_order,
            visibility_order=visibility_order,
            projection=onto,
            factors=few,
        )
    except KeyboardInterrupt:
        kept = f"; {folder} keeps what is done, the same command goes on from there" if folder.exists() else ""
        complain(f"stopped{kept}")
        raise typer.Exit(130) from None
    if half:
        transfer = transfer.to(torch.float16)
    prt.save_transfer(transfer, output)
    if not unshadowed:
        shutil.rmtree(folder, ignore_errors=True)
    say(f"\n{output}: {describe(transfer)}, baked in {time.perf_counter() - start:.1f} s")
    for line in details(transfer)[1:]:
        say(line)
