"""`torchprt shade`: transfer and a light to radiance, a coloured mesh or a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import bake_options, options
from torchprt.cli import picture_options as asked
from torchprt.cli.emitters import Emitters, LampShader, emitters, told, with_points
from torchprt.cli.pose import in_pose
from torchprt.cli.report import say, triple
from torchprt.errors import InputError
from torchprt.files import check_writable, write_array
from torchprt.suffixes import PICTURES
from torchprt.words import count

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.preview import Camera
    from torchprt.transfer import Transfer


def shade(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".npy of radiance, .ply or .glb with colours, .png .jpg or .webp.")
    ],
    light: asked.LightOrLamps = None,
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

    Of a volume it is the source radiance of the cells that hold anything, in their order.

    Exposure and tone are of .ply, .glb and .png; size, camera and background of the .png, which is that of `render`.
    """
    ends = check_writable(output, (".npy", ".ply", ".glb", *PICTURES)).suffix.lower()

    import torch

    import torchprt as prt
    from torchprt import preview, sh

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
    seen = options.eye(eye, toward)
    loaded = prt.load_transfer(transfer)
    if with_ground:
        loaded = loaded.with_ground()
    if ends in (".ply", ".glb"):
        options.surface_of(loaded, ends, transfer, "write .npy or a picture")
    for option, given in (("--emitter", lamps), ("--pose", pose)):
        if given:
            options.surface_of(loaded, option, transfer)
    loaded = with_points(loaded, lamps)
    rest, moved = loaded, dict[str, torch.Tensor]()
    if pose:
        loaded, moved = in_pose(rest, pose)
    framed = picture.camera(loaded) if ends in PICTURES else None
    chosen, seen = options.gloss_of(loaded, material), _eye_of(loaded, seen, framed)
    environment = picture.environment(loaded.order, bool(lamps) and light is None)
    shader = prt.shader(rest, brdf=chosen)
    turned = sh.rotate(environment.light, picture.rotation)
    near = LampShader(shader, rest, lamps) if lamps else None
    with torch.no_grad():
        found = shader(turned, **seen, **moved) if near is None else near.local(near.under(turned), **seen, **moved)
        radiance = found.float()
    studio = picture.studio(loaded, shader, environment, near=near)
    # Others were filled from their neighbours.
    place = "vertex" if loaded.receivers.on_surface else "cell"
    dark = int(((loaded.normals == 0).all(-1) & (radiance == 0).all(-1)).sum())
    if dark and loaded.receivers.on_surface:
        say(f"{dark} of {count(len(radiance), 'vertex')} without a normal read 0")
    negative = int((radiance < 0).any(-1).sum())
    if negative:
        share = f"{negative} of {count(len(radiance), place)}"
        say(f"negative radiance at {share}, down to {float(radiance.min()):.3g}: {_why_negative(window, bool(seen))}")
    model = loaded.without_ground()
    if ends in (".ply", ".glb") and model is not loaded:
        loaded, radiance = model, radiance[~loaded.receivers.ground()]
    if framed is not None:
        preview.save_picture(studio.picture(framed, picture.rotation, radiance), output)
    elif ends == ".ply":
        preview.save_ply(loaded.positions, loaded.faces, preview.colours(radiance, studio.exposure, tone), output)
    elif ends == ".glb":
        linear = preview.linear_colours(radiance, studio.exposure, tone)
        say(f"{output}: {preview.save_lit_glb(loaded, linear, output, near=transfer.parent)}")
    else:
        radiance = loaded.receivers.in_mesh_order(radiance)
        write_array(output, radiance.contiguous().numpy())
    shown = "" if ends == ".npy" else f", exposure {studio.exposure:+.2f} stops"
    mean = f"{count(len(radiance), place)}, mean radiance {triple(radiance.mean(0))}"
    under = told(lamps, None if light is None else environment.name) if lamps else environment.name
    say(f"{output}: {mean}{shown}, under {under}")


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


def _why_negative(window: str | None, glossy: bool) -> str:
    if glossy:
        mended = "" if window == "least" else ", --window least takes away what the light does"
        return f"the light and the gloss ring at their orders{mended}"
    if window == "least":
        return "the light does not ring under this window, the transfer does"
    mended = "least takes that away" if window == "auto" else "auto takes nearly all of that away"
    return f"the light rings at this order, --window {mended}"
