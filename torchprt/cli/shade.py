"""`torchprt shade`: transfer and a light to radiance, a coloured mesh or a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import options
from torchprt.cli.pose import in_pose
from torchprt.cli.report import say, triple
from torchprt.errors import InputError
from torchprt.files import atomic, check_writable

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.preview import Camera
    from torchprt.transfer import Transfer


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
    material: options.OpenGloss = None,
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
        loaded, moved = in_pose(rest, pose)
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
        say(f"{output}: {preview.save_lit_glb(loaded, linear, output, near=transfer.parent)}")
    else:
        radiance = loaded.receivers.in_mesh_order(radiance)
        with atomic(output) as temporary, temporary.open("wb") as stream:
            np.save(stream, radiance.contiguous().numpy())
    say(f"{output}: {len(radiance)} vertices, mean radiance {triple(radiance.mean(0))}")


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
