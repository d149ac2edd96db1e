"""`torchprt cast`: an object over receivers that it has never seen, in a picture or an animation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from torchprt.cli import options
from torchprt.cli import picture_options as asked
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.files import check_writable
from torchprt.suffixes import MOVIES, PICTURES
from torchprt.words import count

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.scene import Mesh
    from torchprt.transfer import Transfer

MOST = 720


def cast(
    around: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt neighbourhood` wrote.")],
    receiver: Annotated[
        Path, typer.Argument(help="What it stands over: a mesh, or a .safetensors of `torchprt bake`.")
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", help=".png or .jpg (several as a sheet), .webp, .gif or .mp4.")
    ],
    path: Annotated[
        list[str] | None,
        typer.Option(
            help="Where the object goes: X,Y,Z[,YAW[,PITCH,ROLL]], several with ; between them. Repeat it for another "
            "copy of the object.",
            show_default="0,0,0",
        ),
    ] = None,
    model: Annotated[Path | None, typer.Option(help="A bake of the object, to show it too.")] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            min=1, max=MOST, help="Pictures along the path.", show_default="48 of what moves, else one a pose"
        ),
    ] = None,
    rate: Annotated[float, typer.Option(help="Pictures a second of what moves, up to 50.")] = 15.0,
    albedo: Annotated[str | None, typer.Option(help="Of a mesh: 0.5, or r,g,b.", show_default="0.5")] = None,
    light: asked.Light = asked.LIGHT,
    rotate: asked.Rotate = asked.ROTATE,
    window: asked.Window = None,
    size: asked.Size = asked.SIZE,
    view: asked.View = asked.VIEW,
    target: asked.Target = None,
    distance: asked.Distance = None,
    fov: asked.Fov = asked.FOV,
    samples: asked.Samples = asked.SAMPLES,
    exposure: asked.Exposure = None,
    tone: asked.Tone = asked.TONE,
    repair: asked.Repair = False,
) -> None:
    """Picture, or animation along a path, of an object that casts its shadow on what it has never seen."""
    ends = check_writable(output, tuple(dict.fromkeys((*PICTURES, *MOVIES)))).suffix.lower()
    fastest = 120 if ends == ".mp4" else 50
    if not 0 < rate <= fastest:
        raise InputError(f"--rate is {rate}: give pictures a second, above 0 and up to {fastest}")
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
        background=False,
        backdrop=None,
        exposure=exposure,
        tone=tone,
        repair=repair,
    )
    keys = [keys_of(each) for each in path or ["0,0,0"]]

    import torch

    from torchprt import preview
    from torchprt.transfer import load

    if ends == ".mp4":
        preview.check_video()
    moves = "#" in output.name or ends in (".gif", ".mp4")
    many = frames or (48 if moves else max(map(len, keys)))
    baked = load(around)
    onto = _receiver(receiver, albedo)
    shown = preview.Cast(
        baked,
        onto,
        picture.environment(baked.order),
        model=None if model is None else _model(model),
        albedo=0.5 if albedo is None else options.colour(albedo, "--albedo"),
        camera=preview.frame(
            onto.positions,
            picture.view,
            aspect=picture.size[0] / picture.size[1],
            field=fov,
            target=picture.target,
            distance=distance,
        ),
        size=picture.size,
        exposure=picture.exposure,
        tone=picture.tone,
        samples=samples,
    )
    poses = torch.stack([preview.along(each, many) for each in keys], 1)
    pictures = [shown.picture(each, picture.rotation) for each in poses]
    if moves or (ends in MOVIES and many > 1):
        preview.save_movie(pictures, output, rate)
    else:
        preview.save_picture(preview.strip(pictures), output)
    shape = "{} x {}".format(*picture.size)
    say(f"{output}: {count(many, 'picture')} of {shape}, {count(len(keys), 'object')} over {receiver}")


def keys_of(text: str) -> Tensor:
    """Poses `[K, 6]`, x, y, z and yaw, pitch, roll each, what is left out being 0."""
    import torch

    found = [options.numbers(each, None, "--path") for each in text.split(";") if each.strip()]
    if not found or not all(3 <= len(each) <= 6 for each in found):
        raise InputError(f"--path is '{text}': give X,Y,Z or X,Y,Z,YAW,PITCH,ROLL, several with ; between them")
    return torch.tensor([each + [0.0] * (6 - len(each)) for each in found], dtype=torch.float64)


def _model(path: Path) -> Transfer:
    from torchprt.transfer import load

    found = load(path)
    options.surface_of(found, "--model", path, "give a bake of a mesh")
    return found


def _receiver(path: Path, albedo: str | None) -> Mesh | Transfer:
    if path.suffix.lower() != ".safetensors":
        from torchprt.scene import read_mesh

        return read_mesh(path)
    if albedo is not None:
        raise InputError(f"--albedo is '{albedo}', but {path} is a bake, which has its own: leave it out")
    from torchprt.transfer import load

    found = load(path)
    options.surface_of(found, "a shadow", path, "give a mesh or a bake of one")
    if "reflectance" in found.needs or "receivers" in found.needs:
        raise InputError(f"{path} holds {found.kind} transfer, which is not shaded here: give a bake of a surface")
    return found
