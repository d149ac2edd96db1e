"""`torchprt render`: stills and turntables of a bake, without a display."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from torchprt.cli import bake_options, options
from torchprt.cli import picture_options as asked
from torchprt.cli.bake_on_the_way import Source
from torchprt.cli.emitters import Emitters, LampShader, emitters, told, with_points
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.files import check_writable
from torchprt.suffixes import MOVIES, PICTURES, TRANSPARENT
from torchprt.words import count, either

MOST = 720
SHOWN = ("radiance", "sight")


def render(
    source: Annotated[
        list[Path],
        typer.Argument(help="A .safetensors of `torchprt bake` or `compress`; or meshes or a scene, baked on the way."),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help=".png or .jpg (a turntable as a sheet, or frames-####.png), .webp, .gif or .mp4."
        ),
    ],
    light: asked.LightOrLamps = None,
    emitter: Emitters = None,
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
    show: Annotated[
        str, typer.Option(help="radiance, or sight: which vertices could look out when they were baked.")
    ] = SHOWN[0],
    rate: Annotated[float, typer.Option(help="Pictures a second of what moves, up to 50.")] = 15.0,
    material: Annotated[
        str | None, typer.Option(help="That of the mesh as in bake; or the gloss, for a bake of frame incident.")
    ] = None,
    on: Annotated[
        Path | None,
        typer.Option("--on", help="A mesh with texture coordinates that a patch covers, read at every pixel."),
    ] = None,
    repeat: Annotated[
        str | None, typer.Option(help="With --on: patches from 0 to 1 along u,v.", show_default="1,1")
    ] = None,
    volume: Annotated[
        Path | None, typer.Option(help="The bake of a volume, as a cloud, that stands before and around the model.")
    ] = None,
    with_ground: bake_options.WithGround = False,
    repair: asked.Repair = False,
    bake: bake_options.Keep = None,
    order: bake_options.Order = None,
    rays: bake_options.Rays = None,
    bounces: bake_options.Bounces = None,
    output_order: bake_options.OutputOrder = None,
    seed: bake_options.Seed = None,
    threads: bake_options.CPUs = None,
    albedo: bake_options.Albedo = None,
    specular: bake_options.Specular = None,
    two_sided: bake_options.TwoSided = None,
    blocker: bake_options.Blocker = None,
    ground: bake_options.Ground = None,
    ground_albedo: bake_options.GroundAlbedo = None,
) -> None:
    """Picture of a bake or a mesh, or a turntable of them, without a display. Glossy surfaces follow the camera."""
    ends = check_writable(output, tuple(dict.fromkeys((*PICTURES, *MOVIES)))).suffix.lower()
    fastest = 120 if ends == ".mp4" else 50
    if not 0 < rate <= fastest:
        raise InputError(f"--rate is {rate}: give pictures a second, above 0 and up to {fastest}")

    import torchprt as prt
    from torchprt import preview

    if ends == ".mp4":
        preview.check_video()
    picture = asked.picture_options(
        light=light or asked.LIGHT,
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
    lamps = emitters(emitter)
    options.choice(show, "--show", SHOWN)
    if repeat is not None and on is None:
        raise InputError("--repeat is for a patch on a mesh: name the mesh with --on")
    if on is not None and show != SHOWN[0]:
        raise InputError(f"--show is {show}, but a patch has no vertices: leave it or --on out")
    if volume is not None and (on is not None or show != SHOWN[0]):
        raise InputError("--volume is given, which goes with radiance at vertices: leave it, or --on and --show, out")
    times = options.numbers("1,1" if repeat is None else repeat, 2, "--repeat")
    if turntable and light_turntable:
        raise InputError("--turntable and --light-turntable are both given: give one, the other stands still")
    if picture.background == "transparent" and ends not in TRANSPARENT:
        raise InputError(f"--backdrop is transparent, which {output} cannot hold: write {either(TRANSPARENT)}")
    given: dict[str, Any] = {"order": order, "rays": rays, "bounces": bounces, "output_order": output_order}
    given |= {"seed": seed, "threads": threads, "albedo": albedo, "material": material, "specular": specular}
    given |= {
        "two_sided": two_sided,
        "blocker": blocker,
        "ground": ground,
        "ground_albedo": ground_albedo,
    }
    opened = Source(source, bake, given)
    if on is not None and opened.scene is not None:
        raise InputError(f"--on is given, but {source[0]} is a mesh: give a patch that `torchprt patch` wrote")
    if on is not None and lamps:
        raise InputError("--emitter is given, but a patch is lit by one light from far away: leave it or --on out")
    environment = picture.environment(opened.order, bool(lamps) and light is None)
    loaded = opened.transfer()
    if lamps and volume is not None:
        raise InputError("--emitter is given, but a volume is lit by one light from far away: leave it or --volume out")
    for option, asked_for in (("--emitter", lamps), ("--show", show != SHOWN[0]), ("--volume", volume is not None)):
        if asked_for:
            options.surface_of(loaded, option, source[0])
    loaded = with_points(loaded, lamps)
    around = () if volume is None else (prt.load_transfer(volume),)
    chosen = None if opened.scene else options.gloss_of(loaded, material)
    if with_ground:
        loaded = loaded.with_ground()
    colours = preview.sight_colours(loaded.receivers) if show == "sight" else None
    if on is None:
        shader = prt.shader(loaded, brdf=chosen)
        near = LampShader(shader, loaded, lamps) if lamps else None
        studio = picture.studio(loaded, shader, environment, colours, near, *around)
    else:
        studio = picture.patch_studio(loaded, on, times, chosen, environment)
        loaded = studio.transfer
    if turntable:
        pictures = list(studio.turntable(turntable, picture.orbit(loaded, *around, sides=turntable), picture.rotation))
    elif light_turntable:
        pictures = list(studio.light_turntable(light_turntable, picture.camera(loaded, *around), picture.rotation))
    else:
        pictures = [studio.picture(picture.camera(loaded, *around), picture.rotation)]
    if "#" in output.name or ends in (".gif", ".mp4") or (ends in MOVIES and len(pictures) > 1):
        preview.save_movie(pictures, output, rate)
    else:
        preview.save_picture(preview.strip(pictures), output)
    shape = "{} x {}".format(*picture.size)
    made = f"{output}: {count(len(pictures), 'picture')} of {shape}"
    if show == "sight":
        for line in preview.sight_legend(loaded.receivers):
            say(line)
        say(f"{made}, sight of the vertices")
        return
    under = told(lamps, None if light is None else environment.name) if lamps else environment.name
    say(f"{made}, exposure {studio.exposure:+.2f} stops, under {under}")
