"""`torchprt bake`: meshes to transfer."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchprt.cli import bake_options, options
from torchprt.cli.report import details, say
from torchprt.errors import InputError
from torchprt.files import check_writable

if TYPE_CHECKING:
    from torchprt.measure import Recipe
    from torchprt.scene import Scene
    from torchprt.transfer import Transfer


def bake(
    mesh: Annotated[
        list[Path],
        typer.Argument(
            help="Meshes that receive light (.ply .obj .glb .gltf .stl .off .usd), each alone or as MESH=MATERIAL, "
            "ring.ply=mirror:gold; or a scene, .toml."
        ),
    ],
    output: options.Output,
    order: bake_options.Order = None,
    rays: bake_options.Rays = None,
    bounces: bake_options.Bounces = None,
    albedo: bake_options.Albedo = None,
    material: bake_options.Gloss = None,
    specular: bake_options.Specular = None,
    two_sided: bake_options.TwoSided = None,
    blocker: bake_options.Blocker = None,
    ground: bake_options.Ground = None,
    ground_albedo: bake_options.GroundAlbedo = None,
    volume: bake_options.Through = None,
    texels: bake_options.Texels = None,
    uv: bake_options.UV = None,
    texel_samples: bake_options.TexelSamples = None,
    gutter: bake_options.Gutter = None,
    unshadowed: Annotated[bool, typer.Option("--unshadowed", help="The closed form, without any ray.")] = False,
    raw: Annotated[bool, typer.Option("--raw", help="Leave vertices that cannot see as they are, black.")] = False,
    seed: bake_options.Seed = None,
    threads: bake_options.CPUs = None,
    cluster: bake_options.OnCluster = None,
    checkpoint: bake_options.At = None,
    sample_points: bake_options.SamplePoints = None,
    sample_gradients: bake_options.SampleGradients = False,
    in_parts: bake_options.InParts = None,
    half: Annotated[bool, typer.Option("--half", help="Store transfer in float16.")] = False,
    frame: Annotated[
        str, typer.Option(help="Gloss: exit (baked in), incident (chosen later) or visibility (the least memory).")
    ] = "exit",
    output_order: bake_options.OutputOrder = None,
    visibility_order: Annotated[
        int | None, typer.Option(min=1, max=32, help="Gloss: bands of --frame visibility.", show_default="as --order")
    ] = None,
    projection: Annotated[
        str, typer.Option(help="Gloss: onto the bands: optimal, reduced, zero, odd or even.")
    ] = "optimal",
    factors: Annotated[
        str | None, typer.Option(help="Gloss: factors of view and light instead of bands: 4, or an error, 0.05.")
    ] = None,
    plan: Annotated[
        Path | None, typer.Option(help="A recipe, .toml, of `torchprt plan`, in place of how to bake and to store.")
    ] = None,
) -> None:
    """Bake how meshes shadow and light themselves. Stopped with Ctrl-C, the same command goes on."""
    check_writable(output, (".safetensors",))
    if cluster is not None and threads is not None:
        raise InputError("--threads and --cluster are both given: leave one of the two out")
    count, few = options.bounces(bake_options.BOUNCES if bounces is None else bounces), options.factors(factors)
    kind = options.choice(frame, "--frame", options.FRAMES)
    onto = options.choice(projection, "--projection", options.PROJECTIONS)
    asked = bake_options.lightmap(texels, uv, texel_samples, gutter)
    if asked is not None and sample_points is not None:
        raise InputError("--sample-points are of vertices: leave --texels out, or the points")
    located = bake_options.located(sample_points, sample_gradients, seed or 0)
    recipe, predicted = None, dict[str, float]()
    if plan is not None:
        given = {"order": order, "rays": rays, "bounces": bounces, "unshadowed": unshadowed, "half": half}
        given |= {"output-order": output_order, "visibility-order": visibility_order, "factors": factors}
        given |= {"in-parts": in_parts}
        given |= {"frame": frame != "exit", "projection": projection != "optimal"}
        for name, value in given.items():
            if value not in (None, False):
                raise InputError(f"--{name} is given, but {plan} says how to bake: leave one of them out")
        from torchprt.measure import read_recipe

        recipe, predicted = read_recipe(plan)
    scene = bake_options.scene_of(
        mesh,
        albedo=albedo,
        material=material,
        specular=specular,
        two_sided=two_sided,
        blocker=blocker,
        ground=ground,
        ground_albedo=ground_albedo,
    )
    say(scene)
    through = None if volume is None else bake_options.through(volume)
    if recipe is not None:
        say(f"{plan}: {recipe.name}")
        common = {
            "seed": seed or 0,
            "threads": threads,
            "on": cluster,
            "at": checkpoint,
            "raw": raw,
            "volume": through,
            "lightmap": asked,
        }
        _bake_planned(scene, output, recipe, predicted, located, **common)
        return
    transfer = bake_options.baked(
        scene,
        output,
        half=half,
        store=located,
        in_parts=in_parts,
        order=order or bake_options.ORDER,
        rays=rays or bake_options.RAYS,
        bounces=count,
        shadows=not unshadowed,
        seed=seed or 0,
        threads=threads,
        on=cluster,
        at=checkpoint,
        frame=kind,
        output_order=output_order,
        visibility_order=visibility_order,
        projection=onto,
        factors=few,
        raw=raw,
        volume=through,
        lightmap=asked,
    )
    for line in details(transfer)[1:]:
        say(line)


def _bake_planned(
    scene: Scene,
    output: Path,
    recipe: Recipe,
    predicted: dict[str, float],
    located: Callable[[Transfer], Transfer],
    **arguments: Any,
) -> None:
    """What a recipe says, and what was predicted of it beside what came of it."""
    from torchprt.cli.plan import foretold
    from torchprt.measure import store_recipe

    start = time.perf_counter()
    transfer = bake_options.baked(
        scene,
        output,
        store=lambda transfer: located(store_recipe(transfer, recipe)),
        **recipe.part("bake"),
        **arguments,
    )
    for line in details(transfer)[1:]:
        say(line)
    if predicted:
        say(f"predicted: {foretold(predicted)}")
        achieved = {"bytes": float(transfer.bytes), "seconds": time.perf_counter() - start}
        say(f"achieved: {foretold(achieved)}")
