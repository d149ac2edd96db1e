"""The verbs of the `torchprt` command, a thin function each."""

from __future__ import annotations

import contextlib
import math
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import compressing, covering, fitting, look, options, posing
from torchprt.cli.report import complain, describe, details, say, triple
from torchprt.errors import InputError
from torchprt.files import atomic, check_writable

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.preview import Camera
    from torchprt.transfer import Transfer

app = typer.Typer(add_completion=False, no_args_is_help=True, pretty_exceptions_enable=False)

Output = Annotated[Path, typer.Option("-o", "--output", help="File to write.")]
Chosen = Annotated[
    str | None, typer.Option("--material", help="The gloss, for a bake of frame incident: phong:40, ggx:0.3, ...")
]


def main() -> None:
    """Runs the command. Faults of the input are one sentence on standard error and exit code 2."""
    with warnings.catch_warnings():
        # Without the file and the line of the code that warns.
        warnings.showwarning = lambda message, *_, **__: complain(message)
        try:
            app()
        except InputError as fault:
            complain(fault)
            sys.exit(2)


@app.command()
def bake(
    mesh: Annotated[list[Path], typer.Argument(help="Meshes that receive light: .ply .obj .glb .gltf .stl .off")],
    output: Output,
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


@app.command()
def shade(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    light: Annotated[Path, typer.Option(help="An environment image, or an .npy of light coefficients.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".npy of radiance, .ply or .glb with colours, or .png.")
    ],
    rotate: Annotated[str, typer.Option(help="Turns the environment: YAW,PITCH,ROLL in degrees.")] = "0,0,0",
    window: Annotated[str, typer.Option(help="Against ringing: none, hann, lanczos, gauss or auto.")] = "none",
    eye: Annotated[
        str | None, typer.Option(help="Gloss: the point X,Y,Z that sees it.", show_default="the camera of the .png")
    ] = None,
    toward: Annotated[str | None, typer.Option(help="Gloss: the direction X,Y,Z to a distant eye.")] = None,
    pose: Annotated[
        list[Path] | None, typer.Option(help="Of zonal lobes: the baked mesh, its vertices moved (repeat as in bake).")
    ] = None,
    material: Chosen = None,
    exposure: Annotated[float, typer.Option(help="In stops, for .ply, .glb and .png.")] = 0.0,
    tone: Annotated[str, typer.Option(help="filmic or none, for .ply, .glb and .png.")] = "filmic",
    size: Annotated[str, typer.Option(help="Of the .png, in pixels.")] = "800x600",
    view: Annotated[str, typer.Option(help="From the model toward the camera of the .png: X,Y,Z.")] = "0.45,0.35,1",
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Light a bake. `.npy` is linear exit radiance, V x 3, in the vertex order of the mesh file."""
    import numpy as np
    import torch

    import torchprt as prt
    from torchprt import preview, sh

    check_writable(output, (".npy", ".ply", ".glb", ".png"))
    turn = sh.yaw_pitch_roll(torch.tensor(options.numbers(rotate, 3, "--rotate"), dtype=torch.float64)).float()
    side, (width, height) = options.direction(view, "--view"), options.size(size)
    seen = options.eye(eye, toward)
    options.choice(window, "--window", options.WINDOWS)
    options.choice(tone, "--tone", ("filmic", "none"))
    if not abs(exposure) <= 100:
        raise InputError(f"--exposure is {exposure}: give stops from -100 to 100")
    loaded = prt.load_transfer(transfer)
    rest, moved = loaded, dict[str, torch.Tensor]()
    if pose:
        loaded, moved = posing.in_pose(rest, pose)
    still, framed = None, None
    if output.suffix.lower() == ".png":
        framed = preview.frame(loaded.positions, side, aspect=width / height)
        still = preview.Still(loaded.positions, loaded.faces, size=(width, height), camera=framed)
    chosen, seen = options.gloss_of(loaded, material), _eye_of(loaded, seen, framed)
    coefficients = options.windowed(options.light(light, loaded.order, repair), window)
    with torch.no_grad():
        radiance = prt.shader(rest, brdf=chosen)(coefficients, turn, **seen, **moved).float()
    dark = int((loaded.normals.abs().sum(-1) == 0).sum())
    if dark:
        say(f"{dark} of {len(radiance)} vertices have no normal and read 0")
    negative = int((radiance < 0).any(-1).sum())
    if negative:
        fault = "the light rings at this order, --window auto takes that away"
        if seen:
            fault = "the light and the gloss ring at their orders, --window auto takes away what the light does"
        least = float(radiance.min())
        say(f"{negative} of {len(radiance)} vertices have negative radiance, down to {least:.3g}: {fault}")
    if still is not None:
        preview.save_png(still.picture(radiance, exposure=exposure, tone=preview.tone_map(tone)), output)
    elif output.suffix.lower() == ".ply":
        preview.save_ply(loaded.positions, loaded.faces, preview.colours(radiance, exposure, tone), output)
    elif output.suffix.lower() == ".glb":
        linear = preview.linear_colours(radiance, exposure, tone)
        preview.save_glb(loaded.positions, loaded.normals, loaded.faces, output, colour=linear)
    else:
        if isinstance(loaded, prt.transfer.clustered.Clusters):
            radiance = loaded.mesh_order(radiance)
        with atomic(output) as temporary, temporary.open("wb") as stream:
            np.save(stream, radiance.contiguous().numpy())
    say(f"{output}: {len(radiance)} vertices, mean radiance {triple(radiance.mean(0))}")


@app.command()
def light(
    image: Annotated[Path, typer.Argument(help="Latitude-longitude environment: .exr .hdr .png .jpg .tif")],
    output: Annotated[Path, typer.Option("-o", "--output", help=".npy of order^2 x 3 coefficients.")],
    order: Annotated[int, typer.Option(min=1, max=64, help="SH bands.")] = 5,
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels.")] = False,
) -> None:
    """Project an environment image to a light."""
    from torchprt.light import write_coefficients

    check_writable(output, (".npy",))
    coefficients = options.light(image, order, repair)
    write_coefficients(coefficients, output)
    say(f"{output}: order {order}, mean radiance {triple(coefficients[0] / math.sqrt(4 * math.pi))}")


@app.command()
def export(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="The .onnx or .glb to write; with --web a folder.")],
    source: Annotated[
        str | None, typer.Option("--from", help="What the graph takes: light or environment.", show_default="light")
    ] = None,
    size: Annotated[
        int | None, typer.Option(help="Texels along an edge of the environment's cube map.", show_default="32")
    ] = None,
    eye: Annotated[
        str | None, typer.Option(help="Gloss: the eye is a point or a direction.", show_default="point")
    ] = None,
    fix_eye: Annotated[
        str | None, typer.Option(help="Gloss: X,Y,Z of an eye that never moves: a much smaller graph.")
    ] = None,
    fix_light: Annotated[
        Path | None, typer.Option(help="Gloss: an .npy or image of the light that never changes.")
    ] = None,
    pose: Annotated[
        str | None, typer.Option(help="Zonal lobes: the pose is frames or positions.", show_default="frames")
    ] = None,
    material: Chosen = None,
    web: Annotated[bool, typer.Option("--web", help="Write a folder that any web server shows.")] = False,
    light: Annotated[
        list[Path] | None, typer.Option(help="Page: images or .npy to choose from (repeatable).", show_default="four")
    ] = None,
    compressed: Annotated[Path | None, typer.Option(help="Page: what `torchprt compress` made of this bake.")] = None,
    title: Annotated[str | None, typer.Option(help="Page: its title.", show_default="name of the file")] = None,
    order: Annotated[
        int | None, typer.Option(min=1, help=".glb: bands of the transfer in its attributes.", show_default="3")
    ] = None,
) -> None:
    """Write one self-contained .onnx and compare it with torch in ONNX Runtime; or a web page, or a .glb."""
    import torchprt as prt
    from torchprt.cli import ways_out

    ends = output.suffix.lower()
    graph = {"--from": source, "--size": size, "--eye": eye, "--fix-eye": fix_eye, "--fix-light": fix_light}
    graph["--pose"] = pose
    page = {"--light": light, "--compressed": compressed, "--title": title}
    if web:
        ways_out.refuse(graph | {"--order": order}, "a page")
    else:
        check_writable(output, (".onnx", ".glb"))
        ways_out.refuse(page | (graph if ends == ".glb" else {"--order": order}), f"{ends} without --web")
    start = options.choice(source or "light", "--from", ("light", "environment"))
    kind = options.choice(eye or "point", "--eye", ("point", "direction"))
    taken = None if pose is None else options.choice(pose, "--pose", ("frames", "positions"))
    place = None if fix_eye is None else options.numbers(fix_eye, 3, "--fix-eye")
    if kind == "direction" and place is not None:
        options.direction(fix_eye or "", "--fix-eye")
    loaded = prt.load_transfer(transfer)
    if isinstance(loaded, prt.transfer.kinds.DIFFUSE):
        for option, value in (("--eye", eye), ("--fix-eye", fix_eye), ("--fix-light", fix_light)):
            if value is not None:
                raise InputError(f"{option} is given, but {transfer} looks the same from everywhere: leave it out")
    chosen = options.gloss_of(loaded, material)
    if isinstance(loaded, prt.transfer.kinds.INCIDENT) and chosen is not None:
        loaded = prt.shade.with_material(loaded, chosen)
    if web:
        return ways_out.page(loaded, output, light, compressed, title or transfer.stem, chosen)
    if ends == ".glb":
        return ways_out.mesh(loaded, output, order)
    lamps = None if fix_light is None else options.light(fix_light, loaded.order, repair=False)
    texels = 32 if size is None else size
    report = prt.onnx.export(
        loaded, output, source=start, size=texels, eye=kind, fix_eye=place, fix_light=lamps, pose=taken
    )
    say(report)
    if report.parity is not None:
        say(report.parity)


@app.command()
def serve(
    folder: Annotated[Path, typer.Argument(help="A folder that `torchprt export --web` wrote.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="0 for one that is free.")] = 8000,
) -> None:
    """Show a page on this machine, at 127.0.0.1, until Ctrl-C."""
    from torchprt.web import serve as served

    with served(folder, port) as server:
        say(f"{folder} is at http://127.0.0.1:{server.server_port}/ until Ctrl-C")
        with contextlib.suppress(KeyboardInterrupt):
            server.serve_forever()


@app.command()
def info(file: Annotated[Path, typer.Argument(help="A transfer, an .onnx, a light, an image or a mesh.")]) -> None:
    """Say what a file holds."""
    import torchprt as prt

    suffix = file.suffix.lower()
    if suffix == ".safetensors" and prt.transfer.holds_map(file):
        say(f"{file}: {covering.told(prt.transfer.load_map(file))}")
    elif suffix == ".safetensors":
        loaded = prt.load_transfer(file)
        say(f"{file}: {describe(loaded)}")
        for line in details(loaded):
            say(line)
        say(f"{loaded.rays} rays a receiver, seed {loaded.seed}, baked by torchprt {loaded.version}")
    elif suffix == ".onnx":
        for name, value in prt.onnx.describe(file).items():
            say(f"{name}: {value}")
    elif suffix == ".npy":
        coefficients = prt.light.read_coefficients(file)
        order = math.isqrt(len(coefficients))
        say(f"{file}: light of order {order}, mean radiance {triple(coefficients[0] / math.sqrt(4 * math.pi))}")
    elif suffix in (".ply", ".obj", ".glb", ".gltf", ".stl", ".off"):
        say(prt.load(file))
    else:
        image, report = prt.light.read_with_report(file, repair=True)
        say(f"{file}: {image.shape[1]} x {image.shape[0]} pixels\n{report}")


app.command()(compressing.compress)
app.command()(fitting.fit)
app.command()(covering.patch)
app.command()(covering.lay)
app.command()(look.render)
app.command()(look.preview)


@app.command()
def demo(
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for what it makes.")] = Path("demo"),
) -> None:
    """Bake, relight and export the project's own samples; write pictures of all of it."""
    from torchprt.demo import run

    run(output, say)


def _eye_of(transfer: Transfer, given: dict[str, Tensor], camera: Camera | None) -> dict[str, Tensor]:
    """The eye that `transfer` is shaded for: the one given, or that of the picture, which is told."""
    import torch

    from torchprt.transfer.kinds import DIFFUSE

    if isinstance(transfer, DIFFUSE):
        if given:
            raise InputError("--eye and --toward are for glossy transfer: this one looks the same from everywhere")
        return given
    if given:
        return given
    if camera is None:
        raise InputError(
            "glossy transfer looks different from everywhere: give --eye X,Y,Z (a point) or --toward X,Y,Z "
            "(a direction)"
        )
    say("seen by the camera of the picture, from ({:.3g}, {:.3g}, {:.3g})".format(*camera.eye))
    return {"eye": torch.tensor(camera.eye, dtype=torch.float64)}
