"""`torchprt render`: stills and turntables of a bake, without a display."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import options
from torchprt.cli.environments import STUDIO, environment_of
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.files import check_writable
from torchprt.words import count

MOST = 720


def render(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` or `compress` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help=".png (a turntable as a sheet) or .gif.")],
    light: Annotated[
        str, typer.Option(help="An environment image, an .npy of light coefficients, studio or sky.")
    ] = STUDIO,
    size: Annotated[str, typer.Option(help="Of each picture, in pixels.")] = "800x600",
    turntable: Annotated[int, typer.Option(min=0, max=MOST, help="Pictures in which the camera goes around.")] = 0,
    light_turntable: Annotated[int, typer.Option(min=0, max=MOST, help="Pictures in which the light goes around.")] = 0,
    view: Annotated[str, typer.Option(help="From the model toward the camera: X,Y,Z.")] = "0.45,0.35,1",
    rotate: Annotated[str, typer.Option(help="Turns the environment: YAW,PITCH,ROLL in degrees.")] = "0,0,0",
    window: Annotated[str, typer.Option(help="Against ringing: none, hann, lanczos, gauss or auto.")] = "none",
    background: Annotated[bool, typer.Option("--background", help="Show the environment behind the model.")] = False,
    exposure: Annotated[
        float | None, typer.Option(help="In stops.", show_default="by the mean radiance of the light")
    ] = None,
    tone: Annotated[str, typer.Option(help="filmic or none.")] = "filmic",
    rate: Annotated[float, typer.Option(help="Pictures a second of the .gif, up to 50.")] = 15.0,
    material: options.OpenGloss = None,
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Picture of a bake, or a turntable of them, without a display. Glossy surfaces follow the camera."""
    import torch

    import torchprt as prt
    from torchprt import preview, sh

    check_writable(output, (".png", ".gif"))
    turn = sh.yaw_pitch_roll(torch.tensor(options.numbers(rotate, 3, "--rotate"), dtype=torch.float64)).float()
    side, (width, height) = options.direction(view, "--view"), options.size(size)
    options.choice(window, "--window", options.WINDOWS)
    options.choice(tone, "--tone", ("filmic", "none"))
    if turntable and light_turntable:
        raise InputError("--turntable and --light-turntable are both given: give one, the other stands still")
    if not 0 < rate <= 50:
        raise InputError(f"--rate is {rate}: give pictures a second, above 0 and up to 50")
    if exposure is not None and not abs(exposure) <= 100:
        raise InputError(f"--exposure is {exposure}: give stops from -100 to 100")
    loaded = prt.load_transfer(transfer)
    chosen = options.gloss_of(loaded, material)
    environment = environment_of(light, loaded.order, repair)
    environment = dataclasses.replace(environment, light=options.windowed(environment.light, window))
    if background and environment.image is None:
        raise InputError(f"--background is given, but {light} is no image: give one as --light")
    stops = preview.automatic_exposure(environment.light) if exposure is None else exposure
    studio = preview.Studio(
        loaded,
        prt.shader(loaded, brdf=chosen),
        environment,
        size=(width, height),
        exposure=stops,
        tone=preview.tone_map(tone),
        backdrop=background,
    )
    camera = preview.frame(loaded.positions, side, aspect=width / height)
    if turntable:
        orbit = preview.Orbit.around(loaded.positions, side, aspect=width / height, sides=turntable)
        pictures = list(studio.turntable(turntable, orbit, turn))
    elif light_turntable:
        pictures = list(studio.light_turntable(light_turntable, camera, turn))
    else:
        pictures = [studio.picture(camera, turn)]
    if output.suffix.lower() == ".gif":
        preview.save_gif(pictures, output, rate)
    else:
        preview.save_png(preview.strip(pictures), output)
    shape = f"{count(len(pictures), 'picture')} of {width} x {height}"
    say(f"{output}: {shape}, exposure {stops:+.2f} stops, under {environment.name}")
