"""`torchprt preview`: the window."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import options
from torchprt.cli.environments import BUILT_IN, LIGHT_HELP, environment_of
from torchprt.cli.picture_options import TONE, TONES, Tone
from torchprt.cli.report import describe, say


def preview(
    bakes: Annotated[
        list[Path], typer.Argument(help="Bakes of one mesh: a .safetensors, or also with bounces, or compressed.")
    ],
    light: Annotated[
        list[str] | None,
        typer.Option(help=f"{LIGHT_HELP} Repeatable.", show_default="all of these"),
    ] = None,
    size: Annotated[str, typer.Option(help="Of the window, in pixels.")] = "1024x768",
    poses: Annotated[
        Path | None, typer.Option(help="Gives a bake in zonal lobes these poses, .npy of T x V x 3; else it bends.")
    ] = None,
    tone: Tone = TONE,
    material: options.OpenGloss = None,
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Open a window in which the model and its light turn. Its keys are printed, and shown by H."""
    import torchprt as prt
    from torchprt import preview

    shape = options.size(size)
    options.choice(tone, "--tone", TONES)
    preview.check_window()
    opened = {_name(path, bakes): prt.load_transfer(path) for path in bakes}
    for name, transfer in opened.items():
        say(f"{name}: {describe(transfer)}")
    # Those whose reflectance is open, if there are any; the others say that theirs is not.
    incident = [transfer for transfer in opened.values() if "reflectance" in transfer.needs]
    chosen = options.gloss_of((incident or list(opened.values()))[0], material)
    highest = max(transfer.order for transfer in opened.values())
    lights = [environment_of(each, highest, repair) for each in light or BUILT_IN]
    moves = None if poses is None else options.positions(poses)
    session = preview.session_of(opened, lights, brdf=chosen, tone=preview.tone_map(tone), poses=moves)
    preview.show(session, size=shape, name=f"torchprt {bakes[0].stem}", say=say)


def _name(path: Path, among: list[Path]) -> str:
    return path.stem if [each.stem for each in among].count(path.stem) == 1 else str(path)
