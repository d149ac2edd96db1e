"""`torchprt plan`: the cheapest recipe that is right enough for a scene and its lights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import bake_options, options
from torchprt.cli.compress import byte_count, fraction
from torchprt.cli.environments import LIGHT_HELP, environment_of
from torchprt.cli.picture_options import Repair
from torchprt.cli.report import answer, complain, say
from torchprt.errors import InputError
from torchprt.files import check_writable

# As `torchprt.measure.plan.LEAST` and `RUNTIMES` of recipes, which this must not import: --help would wait for torch.
LEAST = ("milliseconds", "bytes", "seconds")
RUNTIMES = ("eager", "compiled", "onnx")
LIGHTS = ("studio", "sky")
ORDER = 8


def plan(
    mesh: Annotated[list[Path], typer.Argument(help="Meshes that receive light, as in bake; or a scene, .toml")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="The recipe, .toml, for `torchprt bake --plan`.")
    ] = None,
    error: Annotated[
        str | None,
        typer.Option(help="That may be made under the lights, 0.01 or 1% (relative RMS).", show_default="1%, or least"),
    ] = None,
    ms: Annotated[float | None, typer.Option(help="Milliseconds of CPU time that a frame may take.")] = None,
    bytes: Annotated[str | None, typer.Option(help="That the transfer may take, 500K or 4M.")] = None,
    least: Annotated[str, typer.Option(help="What to make least: milliseconds, bytes or seconds.")] = LEAST[0],
    light: Annotated[
        list[str] | None, typer.Option(help=f"{LIGHT_HELP} (repeatable)", show_default="studio and sky")
    ] = None,
    eye: Annotated[
        list[str] | None, typer.Option(help="Gloss: a point X,Y,Z that sees it (repeatable).", show_default="around it")
    ] = None,
    order: Annotated[int, typer.Option(min=1, max=16, help="SH bands of the lights that count.")] = ORDER,
    runtime: Annotated[str, typer.Option(help="eager, compiled or onnx.")] = RUNTIMES[0],
    window: Annotated[str, typer.Option(help="none, hann, lanczos, gauss, least or auto.")] = "none",
    repair: Repair = False,
    seed: bake_options.Seed = None,
    albedo: bake_options.Albedo = None,
    material: bake_options.Gloss = None,
    specular: bake_options.Specular = None,
    two_sided: bake_options.TwoSided = None,
    blocker: bake_options.Blocker = None,
    ground: bake_options.Ground = None,
    ground_albedo: bake_options.GroundAlbedo = None,
) -> None:
    """Choose what to bake: the cheapest recipe for an error, a time or a size, and why; nothing is baked yet."""
    if output is not None:
        check_writable(output, (".toml",))
    goal = None if error is None else fraction(error, "--error")
    size = None if bytes is None else byte_count(bytes, "--bytes")
    wanted = options.choice(least, "--least", LEAST)
    how = options.choice(runtime, "--runtime", RUNTIMES)
    under = options.choice(window, "--window", options.WINDOWS)
    seen = [options.numbers(point, 3, "--eye") for point in eye or ()]
    if ms is not None and not 0 < ms < float("inf"):
        raise InputError(f"--ms is {ms}: give milliseconds, above 0")
    import torch

    from torchprt.measure import plan as planned
    from torchprt.measure import write_recipe
    from torchprt.transport.progress import Bar

    names = list(light or LIGHTS)
    lights = torch.stack([environment_of(name, order, repair, "none").light for name in names])
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
    try:
        with Bar(rates=False) as bar:
            found = planned(
                scene,
                lights,
                error=goal,
                milliseconds=ms,
                bytes=size,
                least=wanted,
                eyes=torch.tensor(seen, dtype=torch.float64) if seen else None,
                runtime=how,
                window=under,
                seed=seed or 0,
                report=bar,
            )
    except KeyboardInterrupt:
        complain("stopped; nothing is written")
        raise typer.Exit(130) from None
    answer("\n" + foretold(found.predicted))
    answer(str(found))
    if output is not None:
        notes = (f"for {', '.join(str(each) for each in mesh)} under {', '.join(names)}, bands up to {order - 1}",)
        write_recipe(found.recipe, output, predicted=found.predicted, notes=(*notes, *str(found).splitlines()))
        say(f"{output}: bake it with `torchprt bake --plan {output}` and the same scene")


def foretold(predicted: dict[str, float]) -> str:
    """What a plan predicts, in a line."""
    parts = []
    if "error" in predicted:
        within = f" (below {predicted['bound']:.2%})" if "bound" in predicted else ""
        parts.append(f"error {predicted['error']:.2%}{within}")
    if "milliseconds" in predicted:
        parts.append(f"{predicted['milliseconds']:.3g} ms a frame")
    if "bytes" in predicted:
        parts.append(f"{predicted['bytes'] / 2**20:.3g} MB")
    if "seconds" in predicted:
        parts.append(f"{predicted['seconds']:.3g} s of bake")
    return ", ".join(parts)
