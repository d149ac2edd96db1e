"""`torchprt export`: transfer to an .onnx, to a web page, or to a mesh that carries it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from torchprt.cli import bake_options, options
from torchprt.cli.environments import STUDIO, WORDS, environment_of, light_of
from torchprt.cli.export_page import export_page, export_scene
from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.files import check_writable
from torchprt.words import count

if TYPE_CHECKING:
    from torchprt.onnx import ExportReport
    from torchprt.transfer import Transfer


def export(
    transfer: Annotated[Path, typer.Argument(help="A .safetensors that `torchprt bake` wrote.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The .onnx or .glb to write; with --web or --three a folder.")
    ],
    source: Annotated[
        str | None, typer.Option("--from", help="What the graph takes: light or environment.", show_default="light")
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            help="Texels along an edge of the environment's cube map; of a volume WIDTHxHEIGHT of its picture.",
            show_default="32, 128x128",
        ),
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Volume: the point X,Y,Z that cameras look at.", show_default="its middle")
    ] = None,
    fov: Annotated[
        float | None, typer.Option(help="Volume: angle of view from top to bottom, in degrees.", show_default="35")
    ] = None,
    cells: Annotated[
        bool, typer.Option("--cells", help="Volume: what its cells send, in place of its picture.")
    ] = False,
    eye: Annotated[
        str | None, typer.Option(help="Gloss: the eye is a point or a direction.", show_default="point")
    ] = None,
    fix_eye: Annotated[
        str | None, typer.Option(help="Gloss: X,Y,Z of an eye that never moves: a much smaller graph.")
    ] = None,
    fix_light: Annotated[
        str | None, typer.Option(help=f"Gloss: an .npy or image of the light that never changes, or {WORDS}.")
    ] = None,
    pose: Annotated[
        str | None, typer.Option(help="Zonal lobes: the pose is frames or positions.", show_default="frames")
    ] = None,
    local: Annotated[
        bool, typer.Option("--local", help="It takes a light for each sample point of the bake and blends them.")
    ] = False,
    material: options.OpenGloss = None,
    web: Annotated[bool, typer.Option("--web", help="Write a folder that any web server shows.")] = False,
    gpu: Annotated[
        bool, typer.Option("--gpu", help="Page: it shades on the graphics card, and needs no ONNX Runtime.")
    ] = False,
    three: Annotated[
        bool, typer.Option("--three", help="Write a folder for scenes of three.js: mesh, transfer, module, example.")
    ] = False,
    light: Annotated[
        list[str] | None,
        typer.Option(
            help=f"Page, --three: images or .npy to choose from, or {WORDS} (repeatable). .glb of texels: its light.",
            show_default="all of these; studio",
        ),
    ] = None,
    compressed: Annotated[Path | None, typer.Option(help="Page: what `torchprt compress` made of this bake.")] = None,
    title: Annotated[
        str | None, typer.Option(help="Page, --three: its title.", show_default="name of the file")
    ] = None,
    cast: Annotated[
        Path | None, typer.Option(help="Page: of `torchprt neighbourhood`: an object that flies over the model.")
    ] = None,
    model: Annotated[Path | None, typer.Option(help="Page: a bake of that object, to show it.")] = None,
    path: Annotated[
        str | None, typer.Option(help="Page: where it goes: X,Y,Z[,YAW[,PITCH,ROLL]], several with ; between them.")
    ] = None,
    exact: Annotated[
        bool, typer.Option("--exact", help="Page, --three: weights and places in float32, as in .onnx.")
    ] = False,
    order: Annotated[
        int | None,
        typer.Option(
            min=1, help=".glb, --three: bands of the transfer as attributes of vertices.", show_default="3, textures"
        ),
    ] = None,
    asset: Annotated[
        Path | None,
        typer.Option(
            "--source", help=".glb, --three: the glTF that was baked, to keep.", show_default="as the bake says"
        ),
    ] = None,
    with_ground: bake_options.WithGround = False,
    only: Annotated[
        list[str] | None,
        typer.Option(help="One of several objects, by the name of its mesh in `torchprt info` (repeatable)."),
    ] = None,
) -> None:
    """Write one self-contained .onnx and compare it with torch in ONNX Runtime; or a web page, a scene, or a .glb."""
    import torchprt as prt

    ends = output.suffix.lower()
    graph: dict[str, Any] = {
        "--from": source,
        "--size": size,
        "--eye": eye,
        "--fix-eye": fix_eye,
        "--fix-light": fix_light,
    }
    graph |= {"--pose": pose, "--local": local or None}
    seen = {"--target": target, "--fov": fov, "--cells": cells or None}
    graph |= seen
    mesh = {"--order": order, "--source": asset}
    page = {"--light": light, "--compressed": compressed, "--title": title, "--exact": exact or None}
    page |= {"--cast": cast, "--model": model, "--path": path, "--gpu": gpu or None}
    if web and three:
        raise InputError("--web and --three are given: each is a folder of its own, write them one after the other")
    if three:
        both = ("--light", "--title", "--exact")
        _refuse(graph | {name: value for name, value in page.items() if name not in both}, "--three")
    elif web:
        _refuse(graph | mesh, "a page")
    else:
        if not ends:
            raise InputError(
                f"{output} must end in .onnx or .glb; to write a page into that folder give --web, for three.js --three"
            )
        check_writable(output, (".onnx", ".glb"))
        unfit = page | (graph if ends == ".glb" else mesh)
        if ends == ".glb":
            # Texels are lit.
            del unfit["--light"]
        _refuse(unfit, f"{ends} without --web")
    flight = None
    if cast is not None:
        if model is None or path is None:
            raise InputError("--cast is given without --model or --path: give a bake of the object, and where it goes")
        flight = (cast, model, path)
    elif model is not None or path is not None:
        raise InputError("--model or --path is given without --cast: give the neighbourhood that casts the shadow too")
    start = options.choice(source or "light", "--from", ("light", "environment"))
    kind = options.choice(eye or "point", "--eye", ("point", "direction"))
    taken = None if pose is None else options.choice(pose, "--pose", ("frames", "positions"))
    place = None if fix_eye is None else options.numbers(fix_eye, 3, "--fix-eye")
    if kind == "direction" and place is not None:
        options.direction(fix_eye or "", "--fix-eye")
    loaded = prt.load_transfer(transfer)
    if "eye" not in loaded.needs:
        for option, value in (("--eye", eye), ("--fix-eye", fix_eye), ("--fix-light", fix_light)):
            if value is not None:
                raise InputError(f"{option} is given, but {transfer} looks the same from everywhere: leave it out")
    if "receivers" in loaded.needs and not (web or three) and ends == ".onnx":
        _refuse(graph, "the graph of a neighbourhood")
        return _told(prt.onnx.export_neighbourhood(loaded, output))
    if not loaded.receivers.on_surface:
        if ends == ".glb":
            options.surface_of(loaded, ".glb", transfer, "write .onnx or, with --web, a page")
        if not web and not three and not cells:
            others = {name: value for name, value in graph.items() if name not in (*seen, "--size")}
            _refuse(others, "a volume's picture")
            shape = (128, 128) if size is None else options.size(size)
            place = None if target is None else options.numbers(target, 3, "--target")
            return _told(
                prt.onnx.export_volume(loaded, output, size=shape, field=35.0 if fov is None else fov, target=place)
            )
        seen.pop("--cells")
    _refuse(seen, "what is no picture of a volume")
    if only:
        loaded = loaded.only(*only)
    if with_ground and not (web or three) and ends == ".onnx":
        raise InputError("--with-ground is given, but an .onnx holds all that was baked: leave it out")
    if ends != ".onnx" and not with_ground:
        loaded = loaded.without_ground()
    chosen = options.gloss_of(loaded, material)
    if chosen is not None:
        loaded = prt.shade.with_material(loaded, chosen)
    if web:
        named = title or transfer.stem
        return export_page(loaded, output, light, compressed, named, chosen, with_ground, exact, flight, gpu)
    if three:
        return export_scene(loaded, output, light, title or transfer.stem, exact, order, asset, transfer.parent)
    if ends == ".glb" and loaded.receivers.surface_uv is not None:
        _refuse({"--order": order}, "a .glb of texels, which is lit,")
        return _export_lit(loaded, output, light, asset, transfer.parent)
    if ends == ".glb":
        _refuse({"--light": light}, "a .glb of vertices, which carries transfer for every light,")
        return _export_mesh(loaded, output, order, asset, transfer.parent)
    lamps = None if fix_light is None else light_of(fix_light, loaded.order)
    texels = 32 if size is None else options.whole(size, "--size")
    report = prt.onnx.export(
        loaded, output, source=start, size=texels, eye=kind, fix_eye=place, fix_light=lamps, pose=taken, local=local
    )
    _told(report)


def _told(report: ExportReport) -> None:
    say(report)
    if report.parity is not None:
        say(report.parity)


def _export_mesh(transfer: Transfer, path: Path, order: int | None, given: Path | None, near: Path) -> None:
    """Writes the `.glb` with transfer of low order as attributes, of the asset that was baked or of a plain mesh."""
    from torchprt.preview import find_asset, save_transfer_glb

    bands = min(3, transfer.order) if order is None else order
    asset, why = find_asset(transfer, given, near)
    save_transfer_glb(transfer, path, bands, asset=asset)
    albedo = "COLOR_0" if asset is None else "_PRT_ALBEDO"
    say(f"{path}: {count(transfer.vertices, 'vertex')}, albedo in {albedo}, transfer of order {bands} in _PRT_n; {why}")


def _export_lit(transfer: Transfer, path: Path, words: list[str] | None, given: Path | None, near: Path) -> None:
    """Writes the `.glb` that shows the map of an atlas under one light."""
    import torch

    import torchprt as prt
    from torchprt import preview

    if "eye" in transfer.needs:
        raise InputError(
            "gloss looks different from everywhere: give an eye to `torchprt shade`, which writes .glb too"
        )
    if words is not None and len(words) > 1:
        raise InputError(f"--light is given {len(words)} times: a .glb shows one, `torchprt shade` writes one for each")
    environment = environment_of(words[0] if words else STUDIO, transfer.order, repair=False)
    exposure = preview.automatic_exposure(environment.light)
    with torch.no_grad():
        radiance = prt.shader(transfer)(environment.light)
    colours = preview.linear_colours(radiance, exposure)
    told = preview.save_lit_glb(transfer, colours, path, given=given, near=near)
    say(f"{path}: {count(transfer.vertices, 'texel')} under {environment.name}, exposure {exposure:+.2f} stops; {told}")


def _refuse(given: Mapping[str, Any], written: str) -> None:
    """InputError if one of these options has a value, which `written` has no use for."""
    for option, value in given.items():
        if value is not None:
            raise InputError(f"{option} is given, but {written} has no use for it: leave it out")
