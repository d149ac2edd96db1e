"""`torchprt neighbourhood`: an object to what it does to the light around it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import bake_options, options
from torchprt.cli.compress import fraction
from torchprt.cli.report import details, say
from torchprt.errors import InputError
from torchprt.files import check_writable

if TYPE_CHECKING:
    from torchprt.transfer import Transfer


def neighbourhood(
    mesh: Annotated[
        list[Path],
        typer.Argument(help="Meshes of the object: .ply .obj .glb .gltf .stl .off .usd; or a scene, .toml"),
    ],
    output: options.Output,
    grid: Annotated[
        str, typer.Option(help="Nodes: how many in all, or along x, y (up) and z, as 64x8x64.", show_default="32768")
    ] = "32768",
    box: Annotated[
        str | None,
        typer.Option(help="Its corners X0,Y0,Z0,X1,Y1,Z1.", show_default="what encloses the shadow"),
    ] = None,
    share: Annotated[
        str, typer.Option(help="Of the light of what faces up: what the object may take beyond that box.")
    ] = "2%",
    output_order: Annotated[
        int, typer.Option(min=1, max=64, help="Bands of what arrives: 3 for diffuse receivers, more for gloss.")
    ] = 3,
    order: bake_options.Order = None,
    rays: Annotated[int, typer.Option(min=1, max=1 << 22, help="Rays a node, over the sphere.")] = 1024,
    bounces: bake_options.Bounces = None,
    albedo: bake_options.Albedo = None,
    material: bake_options.Gloss = None,
    specular: bake_options.Specular = None,
    two_sided: bake_options.TwoSided = None,
    blocker: bake_options.Blocker = None,
    seed: bake_options.Seed = None,
    threads: bake_options.CPUs = None,
    cluster: bake_options.OnCluster = None,
    checkpoint: bake_options.At = None,
    half: Annotated[bool, typer.Option("--half", help="Store transfer in float16.")] = False,
) -> None:
    """Bake what an object does to the light around it: shadows for what it has never seen. See `torchprt cast`."""
    check_writable(output, (".safetensors",))
    count = options.bounces(bake_options.BOUNCES if bounces is None else bounces)
    nodes, part = nodes_of(grid), fraction(share, "--share")
    corners = None if box is None else options.numbers(box, 6, "--box")
    scene = bake_options.scene_of(
        mesh,
        albedo=albedo,
        material=material,
        specular=specular,
        two_sided=two_sided,
        blocker=blocker,
        ground=None,
        ground_albedo=None,
    )
    say(scene)

    from torchprt.transport import bake_neighbourhood

    def make(folder: Path | str | None) -> Transfer:
        return bake_neighbourhood(
            scene,
            order=order or bake_options.ORDER,
            output_order=output_order,
            grid=nodes,
            box=corners,
            share=part,
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


def nodes_of(text: str) -> int | list[int]:
    """`32768`, or `64x8x64`."""
    parts = text.split("x")
    if len(parts) not in (1, 3) or not all(part.isdecimal() and part.isascii() for part in parts):
        raise InputError(f"--grid is '{text}': give a number of nodes, or three counts along x, y and z, as 64x8x64")
    counts = [int(part) for part in parts]
    return counts[0] if len(counts) == 1 else counts
