"""The verbs that are looked at: stills, turntables, the window."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import options
from torchprt.cli.report import describe, say
from torchprt.errors import InputError
from torchprt.files import check_writable

if TYPE_CHECKING:
    from torchprt.preview import Environment

# Environments for whoever has none at hand.
STUDIO, SKY = "studio", "sky"
MOST = 720

Chosen = Annotated[
    str | None, typer.Option("--material", help="The gloss, for a bake of frame incident: phong:40, ggx:0.3, ...")
]


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
    material: Chosen = None,
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
    environment = _environment(light, loaded.order, repair)
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
    count = "1 picture" if len(pictures) == 1 else f"{len(pictures)} pictures"
    say(f"{output}: {count} of {width} x {height}, exposure {stops:+.2f} stops, under {environment.name}")


def preview(
    bakes: Annotated[
        list[Path], typer.Argument(help="Bakes of one mesh: a .safetensors, or also with bounces, or compressed.")
    ],
    light: Annotated[
        list[str] | None,
        typer.Option(help="An environment image, an .npy, studio or sky (repeatable).", show_default="studio and sky"),
    ] = None,
    size: Annotated[str, typer.Option(help="Of the window, in pixels.")] = "1024x768",
    poses: Annotated[
        Path | None, typer.Option(help="Gives a bake in zonal lobes these poses, .npy of T x V x 3; else it bends.")
    ] = None,
    tone: Annotated[str, typer.Option(help="filmic or none.")] = "filmic",
    material: Chosen = None,
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Open a window in which the model and its light turn. Its keys are printed, and shown by H."""
    import torchprt as prt
    from torchprt import preview

    shape = options.size(size)
    options.choice(tone, "--tone", ("filmic", "none"))
    preview.check_window()
    opened = {_name(path, bakes): prt.load_transfer(path) for path in bakes}
    for name, transfer in opened.items():
        say(f"{name}: {describe(transfer)}")
    # Those whose reflectance is open, if there are any; the others say that theirs is not.
    incident = [transfer for transfer in opened.values() if transfer.kind.endswith("incident")]
    chosen = options.gloss_of((incident or list(opened.values()))[0], material)
    highest = max(transfer.order for transfer in opened.values())
    lights = [_environment(each, highest, repair) for each in light or (STUDIO, SKY)]
    moves = None if poses is None else options.positions(poses)
    session = preview.Session(opened, lights, brdf=chosen, tone=preview.tone_map(tone), poses=moves)
    preview.show(session, size=shape, name=f"torchprt {bakes[0].stem}", say=say)


def _name(path: Path, among: list[Path]) -> str:
    return path.stem if [each.stem for each in among].count(path.stem) == 1 else str(path)


def _environment(word: str, order: int, repair: bool) -> Environment:
    """The environment of a file, or one that is always there."""
    from torchprt import light, sh
    from torchprt.preview import Environment

    path = Path(word)
    if word == SKY:
        # A sun is too small for any order: the weakest window that leaves no negative light.
        sky = light.clear_sky((0.55, 0.6, 0.5), 3.0, order)
        return Environment(word, sh.least_window(sky)[0].float())
    if path.suffix.lower() == ".npy":
        return Environment(path.name, light.read_coefficients(path, order))
    image = light.studio(256) if word == STUDIO else options.environment(path, repair)
    return Environment(path.name, light.project(image, order), image)
