"""What a bake can be told, by whoever bakes: the verb itself, or one that bakes on the way."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from torchprt.cli import options
from torchprt.cli.report import complain, describe, say
from torchprt.errors import InputError
from torchprt.suffixes import MESHES, check_readable

if TYPE_CHECKING:
    from torchprt.scene import Lightmap, Object, Scene
    from torchprt.transfer import Transfer

ORDER, RAYS, BOUNCES = 5, 1024, "auto"
# Panels of --help.
SCENE, BAKE = "Scene", "Bake"
LOWEST = "auto"
"""The height of a ground that is given without one."""

Order = Annotated[
    int | None,
    typer.Option(
        "--order",
        rich_help_panel=BAKE,
        min=1,
        max=64,
        help="SH bands of the light that it will answer to.",
        show_default="5",
    ),
]
Rays = Annotated[
    int | None,
    typer.Option(
        "--rays",
        rich_help_panel=BAKE,
        min=1,
        max=1 << 22,
        help="Rays a vertex, over its hemisphere.",
        show_default="1024",
    ),
]
Bounces = Annotated[
    str | None,
    typer.Option(
        "--bounces",
        rich_help_panel=BAKE,
        help="How often light is reflected on: 0, 1, 2, ..., inf, or auto: until one adds less than 1 %.",
        show_default="auto",
    ),
]
Albedo = Annotated[
    str | None,
    typer.Option(
        "--albedo",
        rich_help_panel=SCENE,
        help="0.5, or r,g,b; file (colour x texture x vertex colour) or vertex (colours of vertices alone).",
        show_default="file, or 0.5 without, under a gloss 0",
    ),
]
Gloss = Annotated[
    str | None,
    typer.Option(
        "--material",
        rich_help_panel=SCENE,
        help="phong:40 blinn:40 ggx:0.3,0.04 ward:0.1,0.4 membrane:0.5 mirror:gold, marble@100 (100 mm a unit), a "
        ".toml, or file: its own gloss.",
    ),
]
Specular = Annotated[
    str | None, typer.Option("--specular", rich_help_panel=SCENE, help="Weight of the gloss: 0.5, or r,g,b.")
]
TwoSided = Annotated[
    bool | None,
    typer.Option(
        "--two-sided/--single-sided",
        rich_help_panel=SCENE,
        help="Whether surfaces reflect with both sides.",
        show_default="as the file says",
    ),
]
Blocker = Annotated[
    list[Path] | None,
    typer.Option("--blocker", rich_help_panel=SCENE, help="A mesh that only casts shadows (repeatable)."),
]
Ground = Annotated[
    str | None,
    typer.Option(
        "--ground",
        rich_help_panel=SCENE,
        metavar="[HEIGHT]",
        help="A ground that receives the shadow, at this y or at the lowest point.",
    ),
]
GroundAlbedo = Annotated[
    str | None,
    typer.Option("--ground-albedo", rich_help_panel=SCENE, help="Of the ground: 0.5, or r,g,b.", show_default="0.5"),
]
Through = Annotated[
    Path | None,
    typer.Option(
        "--volume",
        rich_help_panel=SCENE,
        help="A cloud whose shadow and light fall on the scene: a .safetensors of `torchprt volume`.",
    ),
]
Seed = Annotated[
    int | None,
    typer.Option("--seed", rich_help_panel=BAKE, min=0, help="Turns the set of directions.", show_default="0"),
]
CPUs = Annotated[
    int | None, typer.Option("--threads", rich_help_panel=BAKE, min=1, help="As many as there are cores by default.")
]
OnCluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        rich_help_panel=BAKE,
        metavar="ADDRESS",
        help="Bake on a Dask cluster: tcp://HOST:PORT of its scheduler, or local:4, four processes of this machine.",
    ),
]
At = Annotated[
    str | None,
    typer.Option(
        "--checkpoint",
        rich_help_panel=BAKE,
        metavar="PLACE",
        help="Where chunks wait that are done: a folder, or s3://..., that all workers of a cluster reach.",
        show_default="OUTPUT.partial",
    ),
]
OutputOrder = Annotated[
    int | None,
    typer.Option(
        "--output-order",
        rich_help_panel=BAKE,
        min=1,
        max=32,
        help="Gloss: bands toward the eye.",
        show_default="as --order",
    ),
]
InParts = Annotated[
    bool | None,
    typer.Option(
        "--in-parts/--whole",
        rich_help_panel=BAKE,
        help="Write the result part by part, never whole in memory; the same file.",
        show_default="in parts if it would take half of the free memory",
    ),
]
Keep = Annotated[
    Path | None,
    typer.Option("--bake", rich_help_panel=BAKE, help="Keep what is baked on the way in this .safetensors."),
]
SamplePoints = Annotated[
    int | None,
    typer.Option(
        "--sample-points",
        rich_help_panel=BAKE,
        min=1,
        max=4096,
        help="For lamps nearby: at how many points about the model their light is taken.",
    ),
]
SampleGradients = Annotated[
    bool,
    typer.Option(
        "--sample-gradients",
        rich_help_panel=BAKE,
        help="Also how it changes there: four lights a point, and a third of the error.",
    ),
]
TEXELS = "Texels"
Texels = Annotated[
    str | None,
    typer.Option(
        "--texels",
        rich_help_panel=TEXELS,
        help="Record at the texels of a map, 1024 along a side, or 1024x512, instead of at vertices.",
        show_default="vertices",
    ),
]
UV = Annotated[
    str | None,
    typer.Option(
        "--uv",
        rich_help_panel=TEXELS,
        help="The set of texture coordinates to use, from 0, or unwrap, which makes charts anew.",
        show_default="1, else 0 if it does, else unwrap",
    ),
]
TexelSamples = Annotated[
    int | None,
    typer.Option(
        "--texel-samples",
        rich_help_panel=TEXELS,
        help="Places in a texel that its rays start from: 1, 4, 9, 16, ...",
        show_default="4",
    ),
]
Gutter = Annotated[
    int | None,
    typer.Option(
        "--gutter",
        rich_help_panel=TEXELS,
        help="Texels around a chart that are filled, for what filters read beside it.",
        show_default="4",
    ),
]


def lightmap(texels: str | None, uv: str | None, samples: int | None, gutter: int | None) -> Lightmap | None:
    """The map that these options ask for, if they do."""
    given = {"--uv": uv, "--texel-samples": samples, "--gutter": gutter}
    if texels is None:
        for name, value in given.items():
            if value is not None:
                raise InputError(f"{name} is given, and no map: give --texels 1024, say")
        return None
    from torchprt.scene import Lightmap

    sides = texels.lower().split("x")
    if len(sides) > 2 or not all(side.isdigit() for side in sides):
        raise InputError(f"--texels is '{texels}': give the texels along a side, 1024, or columns and rows, 1024x512")
    if uv is not None and uv != "unwrap" and not uv.isdigit():
        raise InputError(f"--uv is '{uv}': give the number of a set of texture coordinates, from 0, or unwrap")
    chosen: int | Literal["unwrap"] | None = None if uv is None else "unwrap" if uv == "unwrap" else int(uv)
    return Lightmap(
        (int(sides[0]), int(sides[-1])),
        chosen,
        4 if samples is None else samples,
        4 if gutter is None else gutter,
    )


WithGround = Annotated[
    bool, typer.Option("--with-ground", help="The ground of the bake is part of the model: framed, whole, written.")
]


class GroundCommand(TyperCommand):
    """A verb whose --ground may stand alone."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, spelled_out(args))


def spelled_out(arguments: Sequence[str]) -> list[str]:
    """The arguments with a height after every --ground: the lowest point where no number follows."""
    found: list[str] = []
    for number, word in enumerate(arguments):
        found.append(word)
        following = arguments[number + 1] if number + 1 < len(arguments) else ""
        if word == "--ground" and following != LOWEST and not _is_number(following):
            found.append(LOWEST)
    return found


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def scene_of(
    meshes: Sequence[Path],
    *,
    albedo: str | None,
    material: str | None,
    specular: str | None,
    two_sided: bool | None,
    blocker: Sequence[Path] | None,
    ground: str | None,
    ground_albedo: str | None,
) -> Scene:
    """The scene that these options say."""
    height, floor = None, 0.5 if ground_albedo is None else options.colour(ground_albedo, "--ground-albedo")
    if ground is None and ground_albedo is not None:
        raise InputError(f"--ground-albedo is '{ground_albedo}', but there is no ground: give --ground too")
    if ground is not None and ground != LOWEST:
        (height,) = options.numbers(ground, 1, "--ground")
    for name in (*(_own(each)[0] for each in meshes), *(blocker or ())):
        # A file that is not there is told of before all that reads files is loaded.
        if Path(name).suffix.lower() in MESHES:
            check_readable(name)
    common = {"albedo": options.albedo(albedo), "material": options.surface(material, specular), "two_sided": two_sided}
    from torchprt.scene import Scene

    objects = _objects(meshes, common, blocker or ())
    if ground is None:
        return Scene(objects)
    # A mirror alone is no scene, on a ground it is.
    from torchprt.scene.ground import ground as ground_under

    return Scene([*objects, *ground_under(objects, height, floor)])


def _objects(meshes: Sequence[Path], common: dict[str, Any], blockers: Sequence[Path]) -> list[Object]:
    """The objects of meshes, each of its own material if one is written behind it, as in pot.ply=ggx:0.3."""
    from torchprt.scene import is_scene, load_objects

    parts = [_own(each) for each in meshes]
    if all(said is None for _, said in parts):
        return load_objects(meshes, blockers=blockers, **common)
    given = [f"--{name.replace('_', '-')}" for name, value in common.items() if value is not None]
    if given and all(said is not None for _, said in parts):
        raise InputError(f"{given[0]} is given, but every mesh says its own material: leave one of the two out")
    found: list[Object] = []
    for name, said in parts:
        if is_scene(name):
            raise InputError(f"{name} is a scene, which says its meshes and their materials itself: give it alone")
        found += load_objects(name, **(common if said is None else _said(said)))
    return [*found, *load_objects((), blockers=blockers)]


def _own(mesh: Path) -> tuple[Path, str | None]:
    """The file of a mesh and what is written behind it; a file may have the sign in its name."""
    name, equals, said = str(mesh).rpartition("=")
    return (Path(name), said) if equals and not mesh.exists() else (mesh, None)


def _said(text: str) -> dict[str, Any]:
    """An albedo (one number or three), or a material."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return {"material": options.surface(text, None)}
    return {"albedo": numbers[0] if len(numbers) == 1 else numbers}


def through(file: Path) -> Transfer:
    """What was baked of a volume."""
    from torchprt.transfer import load

    found = load(file)
    try:
        found.receivers.as_cells()
    except InputError as fault:
        raise InputError(f"{file} is no volume, as --volume takes: make one with `torchprt volume`") from fault
    return found


def located(points: int | None, gradients: bool, seed: int) -> Callable[[Transfer], Transfer]:
    """What puts sample points about a bake, if they are asked for."""
    if points is None:
        if gradients:
            raise InputError("--sample-gradients is given, but no points at which they are taken: give --sample-points")
        return lambda transfer: transfer

    def made(transfer: Transfer) -> Transfer:
        from torchprt.light import with_sample_points

        return with_sample_points(transfer, points, gradients=gradients, seed=seed)

    return made


def baked(
    scene: Scene,
    output: Path | None,
    *,
    half: bool = False,
    store: Callable[[Transfer], Transfer] | None = None,
    in_parts: bool | None = False,
    at: str | None = None,
    **arguments: Any,
) -> Transfer:
    """The bake of a scene, `kept` in `output`, and on the way there `at` a place; `in_parts`: written part by part,
    None for if it is large."""
    from torchprt.transport import Output, bake

    parts = output is not None and (_is_large(scene, arguments) if in_parts is None else in_parts)

    def make(folder: Path | str | None) -> Transfer:
        if output is None or not parts:
            return bake(scene, checkpoint=folder, keep=True, **arguments)
        import torch

        out = Output(output, dtype=torch.float16 if half else None, then=store)
        return bake(scene, checkpoint=folder, keep=True, out=out, **arguments)

    return kept(output, make, half=half, store=store, partly=arguments.get("shadows", True), written=parts, at=at)


# The share of free memory that a bake may hold of its result before that is written part by part.
SHARE = 0.5


def _is_large(scene: Scene, arguments: dict[str, Any]) -> bool:
    """Whether a bake would hold much of the memory that is free, and can do without."""
    from torchprt.memory import available
    from torchprt.transport.bake import bytes_held

    asked = {name: arguments.get(name) for name in ("output_order", "lightmap")}
    held = bytes_held(scene, order=arguments["order"], bounces=arguments["bounces"], **asked)
    free = available()
    if free is None or held <= SHARE * free or any(each.material.medium is not None for each in scene.objects):
        return False
    say(f"about {held / 2**30:.1f} GB to hold, {free / 2**30:.1f} GB of memory are free: written part by part")
    return True


def kept(
    output: Path | None,
    make: Callable[[Path | str | None], Transfer],
    *,
    half: bool = False,
    store: Callable[[Transfer], Transfer] | None = None,
    partly: bool = True,
    written: bool = False,
    at: str | None = None,
) -> Transfer:
    """What a bake makes, told of; kept in `output`, if there is one, and on the way there `at` a place, a folder beside
    it unless another is named.

    `store`: what is made of it before it is kept. `partly`: whether it can be kept on the way. `written`: whether it
    is in `output` already when it is made.
    """
    import torch

    from torchprt.transfer import save
    from torchprt.transport.checkpoint import is_there, place_of, remove

    beside = None if output is None else output.with_name(output.name + ".partial")
    folder = (place_of(at) or beside) if partly else None
    start = time.perf_counter()
    try:
        transfer = make(folder)
        if half and not written:
            transfer = transfer.to(torch.float16)
        if store is not None and not written:
            transfer = store(transfer)
        if output is not None and not written:
            save(transfer, output)
    except KeyboardInterrupt:
        left = ""
        if folder is not None and is_there(folder):
            left = f"; {folder} keeps what is done, the same command goes on from there"
        complain(f"stopped{left}")
        raise typer.Exit(130) from None
    if folder is not None:
        remove(folder)
    name = f"{output}: " if output is not None else ""
    say(f"\n{name}{describe(transfer)}, baked in {time.perf_counter() - start:.1f} s")
    return transfer
