"""`torchprt shade`: transfer and lights to radiance, a coloured mesh, a picture or a map."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import bake_options, lit, options
from torchprt.cli import picture_options as asked
from torchprt.cli.emitters import Emitters, LampShader, emitters, told, with_points
from torchprt.cli.pose import in_pose
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.files import check_writable
from torchprt.suffixes import PICTURES

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.preview import Camera, Environment
    from torchprt.transfer import Transfer

    Named = tuple[Path, Environment]

_NUMBERS = 1 << 27
"""Of the radiance of all lights that are applied at once."""


def shade(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            help=".npy of radiance, .ply or .glb with colours, .png .jpg or .webp; of texels .exr .png.",
        ),
    ],
    light: asked.Lights = None,
    emitter: Emitters = None,
    rotate: asked.Rotate = asked.ROTATE,
    window: asked.Window = None,
    eye: Annotated[
        str | None, typer.Option(help="Gloss: the point X,Y,Z that sees it.", show_default="the camera of the .png")
    ] = None,
    toward: Annotated[str | None, typer.Option(help="Gloss: the direction X,Y,Z to a distant eye.")] = None,
    pose: Annotated[
        list[Path] | None, typer.Option(help="Of zonal lobes: the baked mesh, its vertices moved (repeat as in bake).")
    ] = None,
    material: options.OpenGloss = None,
    irradiance: Annotated[
        bool, typer.Option("--irradiance", help="What arrives in place of what leaves: without albedo and gloss.")
    ] = False,
    white: Annotated[
        bool, typer.Option("--white", help="That over pi: what engines multiply with a base colour.")
    ] = False,
    with_ground: bake_options.WithGround = False,
    exposure: asked.Exposure = None,
    tone: asked.Tone = asked.TONE,
    size: asked.Size = asked.SIZE,
    view: asked.View = asked.VIEW,
    target: asked.Target = None,
    distance: asked.Distance = None,
    fov: asked.Fov = asked.FOV,
    samples: asked.Samples = asked.SAMPLES,
    background: asked.ShowEnvironment = False,
    backdrop: asked.Backdrop = None,
    repair: asked.Repair = False,
) -> None:
    """Light a bake. `.npy` is linear exit radiance, V x 3, in the vertex order of the mesh file.

    Of a volume it is the source radiance of the cells that hold anything, in their order. Of texels .npy, .exr (both
    linear) and .png are the map, rows x columns; a picture is made by `torchprt render`.

    Several lights are applied at once: {light} in the name of the output stands for the name of each.

    Exposure and tone are of .ply, .glb and .png; size, camera and background of the .png, which is that of `render`.
    """
    ends = check_writable(output, (".npy", ".ply", ".glb", ".exr", *PICTURES)).suffix.lower()
    files = lit.files_of(output, light or [asked.LIGHT])
    for path in files:
        check_writable(path, (path.suffix.lower(),))
    if emitter and len(files) > 1:
        raise InputError(f"--emitter is given with {len(files)} lights: give one, lamps nearby stand beside it")
    if irradiance and white:
        raise InputError("--irradiance and --white are both given: give one, the second is the first over pi")
    what: lit.What = "irradiance" if irradiance else "white" if white else "radiance"

    import torch

    import torchprt as prt
    from torchprt import sh

    picture = asked.picture_options(
        light=asked.LIGHT,
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
    seen = options.eye(eye, toward)
    loaded = prt.load_transfer(transfer)
    moving = lit.camera_options(size, view, target, distance, fov, samples, background or backdrop is not None)
    lit.check_output(loaded, transfer, output, moving)
    on_map = loaded.receivers.surface_uv is not None
    if with_ground:
        loaded = loaded.with_ground()
    if irradiance or white:
        options.surface_of(loaded, "--irradiance" if irradiance else "--white", transfer)
        loaded = loaded.white()
    if ends in (".ply", ".glb"):
        options.surface_of(loaded, ends, transfer, "write .npy or a picture")
    for option, given in (("--emitter", lamps), ("--pose", pose)):
        if given:
            options.surface_of(loaded, option, transfer)
    if pose and on_map:
        raise InputError(f"--pose is for vertices, and {transfer} was recorded at texels: leave it out")
    loaded = with_points(loaded, lamps)
    rest, moved = loaded, dict[str, torch.Tensor]()
    if pose:
        loaded, moved = in_pose(rest, pose)
    framed = picture.camera(loaded) if ends in PICTURES and not on_map else None
    chosen, seen = options.gloss_of(loaded, material), _eye_of(loaded, seen, framed)
    asked_for = [dataclasses.replace(picture, light=each) for each in light or [asked.LIGHT]]
    environments = [each.environment(loaded.order, bool(lamps) and light is None) for each in asked_for]
    shader = prt.shader(rest, brdf=chosen)
    near = LampShader(shader, rest, lamps) if lamps else None
    under = None if not lamps else told(lamps, environments[0].name if light else None)
    written = lit.Lit(loaded, transfer, picture, shader, near, framed, what, window, bool(seen), under)
    for some in _batches(list(zip(files, environments, strict=True)), 3 * loaded.vertices, near is None):
        turned = torch.stack([sh.rotate(environment.light, picture.rotation) for _, environment in some])
        with torch.no_grad():
            if near is not None:
                found = near.local(near.under(turned[0]), **seen, **moved)[None]
            else:
                found = shader(turned, **seen, **moved) if len(some) > 1 else shader(turned[0], **seen, **moved)[None]
        for (path, environment), radiance in zip(some, found, strict=True):
            written.write(path, environment, radiance.float())


def _batches(lights: Sequence[Named], numbers: int, together: bool) -> Iterator[Sequence[Named]]:
    """The lights that are applied at once: as many as their results have room for."""
    most = max(1, _NUMBERS // max(numbers, 1)) if together else 1
    for start in range(0, len(lights), most):
        yield lights[start : start + most]


def _eye_of(transfer: Transfer, given: dict[str, Tensor], camera: Camera | None) -> dict[str, Tensor]:
    """The eye that `transfer` is shaded for: the one given, or that of the picture, which is told."""
    import torch

    if "eye" not in transfer.needs:
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
