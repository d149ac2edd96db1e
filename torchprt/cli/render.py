"""`torchprt render`: stills and turntables of a bake, without a display."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from torchprt.cli import options
from torchprt.cli import picture_options as asked
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.files import check_writable
from torchprt.suffixes import MOVIES, PICTURES, TRANSPARENT
from torchprt.words import count, either

MOST = 720


def render(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` or `compress` wrote.")],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help=".png or .jpg (a turntable as a sheet, or frames-####.png), .webp, .gif or .mp4."
        ),
    ],
    light: asked.Light = asked.LIGHT,
    size: asked.Size = asked.SIZE,
    turntable: Annotated[int, typer.Option(min=0, max=MOST, help="Pictures in which the camera goes around.")] = 0,
    light_turntable: Annotated[int, typer.Option(min=0, max=MOST, help="Pictures in which the light goes around.")] = 0,
    view: asked.View = asked.VIEW,
    target: asked.Target = None,
    distance: asked.Distance = None,
    fov: asked.Fov = asked.FOV,
    samples: asked.Samples = asked.SAMPLES,
    rotate: asked.Rotate = asked.ROTATE,
    window: asked.Window = None,
    background: asked.ShowEnvironment = False,
    backdrop: asked.Backdrop = None,
    exposure: asked.Exposure = None,
    tone: asked.Tone = asked.TONE,
    rate: Annotated[float, typer.Option(help="Pictures a second of what moves, up to 50.")] = 15.0,
    material: options.OpenGloss = None,
    repair: asked.Repair = False,
) -> None:
    """Picture of a bake, or a turntable of them, without a display. Glossy surfaces follow the camera."""
    ends = check_writable(output, tuple(dict.fromkeys((*PICTURES, *MOVIES)))).suffix.lower()
    fastest = 120 if ends == ".mp4" else 50
    if not 0 < rate <= fastest:
        raise InputError(f"--rate is {rate}: give pictures a second, above 0 and up to {fastest}")

    import torchprt as prt
    from torchprt import preview

    if ends == ".mp4":
        preview.check_video()
    picture = asked.picture_options(
        light=light,
        size=size,
        view=view,
        target=target,
        distance=distance,
        fov=fov,
        samples=samples,
        rotate=rotate,
        window=window,
        background=background,
        backdrop=backdrop,
        exposure=exposure,
        tone=tone,
        repair=repair,
    )
    if turntable and light_turntable:
        raise InputError("--turntable and --light-turntable are both given: give one, the other stands still")
    if picture.background == "transparent" and ends not in TRANSPARENT:
        raise InputError(f"--backdrop is transparent, which {output} cannot hold: write {either(TRANSPARENT)}")
    loaded = prt.load_transfer(transfer)
    chosen = options.gloss_of(loaded, material)
    environment = picture.environment(loaded.order)
    studio = picture.studio(loaded, prt.shader(loaded, brdf=chosen), environment)
    if turntable:
        pictures = list(studio.turntable(turntable, picture.orbit(loaded, turntable), picture.rotation))
    elif light_turntable:
        pictures = list(studio.light_turntable(light_turntable, picture.camera(loaded), picture.rotation))
    else:
        pictures = [studio.picture(picture.camera(loaded), picture.rotation)]
    if "#" in output.name or ends in (".gif", ".mp4") or (ends in MOVIES and len(pictures) > 1):
        preview.save_movie(pictures, output, rate)
    else:
        preview.save_picture(preview.strip(pictures), output)
    shape = "{} of {} x {}".format(count(len(pictures), "picture"), *picture.size)
    say(f"{output}: {shape}, exposure {studio.exposure:+.2f} stops, under {environment.name}")
