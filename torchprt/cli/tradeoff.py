"""`torchprt tradeoff`: what accuracy costs on a scene, before anything is chosen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchprt.cli import bake_options, options
from torchprt.cli.bake_on_the_way import OF_SCENE
from torchprt.cli.environments import WORDS, environment_of
from torchprt.cli.report import answer, complain, say
from torchprt.errors import InputError
from torchprt.words import count

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.measure.tradeoff import Tradeoff
    from torchprt.scene import Scene
    from torchprt.transfer import Transfer

LIGHTS = ("studio", "sky")
# Parts of the time and of the bytes of the base that are told.
PARTS = (2, 4, 8)


def tradeoff(
    source: Annotated[
        list[Path],
        typer.Argument(help="Meshes that receive light, or a scene, .toml; or a .safetensors of `torchprt bake`."),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for tables, plots, pictures and recipes.")],
    light: Annotated[
        list[str] | None,
        typer.Option(help=f"An environment image, .npy, {WORDS} (repeatable).", show_default=" and ".join(LIGHTS)),
    ] = None,
    eye: Annotated[
        list[str] | None,
        typer.Option(help="A point X,Y,Z that sees it (repeatable).", show_default="the camera of pictures"),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A third of the recipes.")] = False,
    keep: Annotated[
        Path | None,
        typer.Option("--cache", help="Folder that keeps what is measured.", show_default="~/.cache/torchprt/tradeoff"),
    ] = None,
    order: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=bake_options.BAKE,
            min=1,
            max=64,
            help="SH bands of the reference.",
            show_default="10, with gloss 8; of a bake its own",
        ),
    ] = None,
    rays: Annotated[
        int | None,
        typer.Option(
            rich_help_panel=bake_options.BAKE,
            min=1,
            max=1 << 22,
            help="Rays a vertex of the reference.",
            show_default="4096",
        ),
    ] = None,
    threads: bake_options.CPUs = None,
    albedo: bake_options.Albedo = None,
    material: bake_options.Gloss = None,
    specular: bake_options.Specular = None,
    two_sided: bake_options.TwoSided = None,
    blocker: bake_options.Blocker = None,
    ground: bake_options.Ground = None,
    ground_albedo: bake_options.GroundAlbedo = None,
    repair: Annotated[bool, typer.Option("--repair", help="Replace NaN and infinite pixels of lights.")] = False,
) -> None:
    """What accuracy costs: orders, rays, bounces, compression, types and runtimes tried side by side on one scene.

    Nothing is measured twice. Stopped with Ctrl-C, the same command goes on.
    """
    given: dict[str, Any] = {"albedo": albedo, "material": material, "specular": specular, "two_sided": two_sided}
    given |= {"blocker": blocker, "ground": ground, "ground_albedo": ground_albedo}
    points = [options.numbers(each, 3, "--eye") for each in eye or []]
    lights = list(dict.fromkeys(light or LIGHTS))

    from torchprt.measure.keep import default_folder
    from torchprt.measure.plot import check_matplotlib
    from torchprt.measure.tradeoff import default_order, tradeoff
    from torchprt.measure.tradeoff_files import check_folder, save_tradeoff
    from torchprt.measure.views import check_flip

    check_folder(output)
    check_matplotlib()
    check_flip()
    opened = _opened(source, {**given, "order": order, "rays": rays})
    wanted = order or default_order(opened)
    known = {
        # Windows are among what is tried.
        name: environment_of(each, wanted, repair, "none").light.double()
        for name, each in zip(_names(lights), lights, strict=True)
    }
    more: dict[str, Any] = {} if rays is None else {"rays": rays}
    folder = default_folder() if keep is None else keep
    try:
        found = tradeoff(
            opened,
            known,
            _eyes(points),
            order=wanted,
            quick=quick,
            keep=folder,
            threads=threads,
            name=" and ".join(each.name for each in source),
            **more,
        )
        save_tradeoff(found, output)
    except KeyboardInterrupt:
        complain(f"stopped; {folder} keeps what is done, the same command goes on from there")
        raise typer.Exit(130) from None
    _tell(found, output)


def _opened(files: list[Path], given: dict[str, Any]) -> Scene | Transfer:
    """The scene of these files, or the bake, of which a scene's options say nothing."""
    if files[0].suffix.lower() != ".safetensors":
        return bake_options.scene_of(files, **{name: given[name] for name in OF_SCENE})
    if len(files) > 1:
        raise InputError(f"{files[0]} is a bake, and {files[1]} is given beside it: give one bake, or meshes alone")
    for name, value in given.items():
        if value is not None and value != []:
            option = "--" + name.replace("_", "-")
            raise InputError(f"{option} is given, but {files[0]} is baked already: leave it out, or give the mesh")
    from torchprt.transfer import load

    loaded = load(files[0])
    options.surface_of(loaded, "a sweep", files[0], "give a mesh")
    return loaded


def _names(lights: list[str]) -> list[str]:
    """Of each light a name: that of its file without the folder, unless two are called so."""
    short = [Path(each).stem if Path(each).suffix else each for each in lights]
    return short if len(set(short)) == len(short) else lights


def _eyes(points: list[list[float]]) -> Tensor | None:
    import torch

    return torch.tensor(points, dtype=torch.float64) if points else None


def _tell(found: Tradeoff, output: Path) -> None:
    from torchprt.measure.front import COSTS, amount, percent

    base = found.base
    say(f"{output}: {count(len(found.points), 'recipe')} measured, {len(found.fronts())} of them on the front")
    say(f"errors are against {found.reference.name}, without a window, under {', '.join(found.lights)}")
    cost = ", ".join(amount(by, base.cost(by)) for by in COSTS)
    answer(f"base: {base.recipe.name}: {cost}, error {percent(base.error)}")
    for by in COSTS:
        for times in PARTS:
            half = found.halved(by, times)
            if half.point is not None:
                answer(f"{half} ({amount(by, half.point.cost(by))})")
    best = [point for point in found.front("seconds") if point.seconds <= base.seconds]
    if best and best[-1].error < base.error:
        point = best[-1]
        answer(f"in the time of the base, error {percent(point.error)}: {point.recipe.name}")
