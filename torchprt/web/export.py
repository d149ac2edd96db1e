"""Writing the folder: the page, its libraries, the graph, the mesh, the lights."""

from __future__ import annotations

import gzip
import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchprt import onnx, preview
from torchprt.errors import InputError
from torchprt.files import atomic_folder, write
from torchprt.onnx.plan import weight_bytes
from torchprt.preview.encode import encoded
from torchprt.preview.environment import Environment
from torchprt.preview.modes import reflectance
from torchprt.shade import at_rest, shader
from torchprt.shade.display import TONE
from torchprt.transfer import Transfer
from torchprt.version import VERSION
from torchprt.web.environment import as_json, of_order, samples, shown
from torchprt.web.flight import Flight
from torchprt.web.libraries import libraries
from torchprt.web.map import MAP, mapped_corners, save_map
from torchprt.web.mesh import save_small_glb
from torchprt.web.packing import pack
from torchprt.web.shader_file import shader_file
from torchprt.web.three import MODULE, apart, gpu_text, module
from torchprt.web.volume import NAME, box, save_volume
from torchprt.words import count

# Share of the RMS radiance that the colours of a difference end at: shadows are large, what compression loses is not.
SHADOWS, COMPRESSION = 1.0, 0.1
MODEL, COMPRESSED = "model.onnx", "compressed.onnx"
# The same for shaders.
SHADED, SHADED_COMPRESSED = "transfer.bin", "compressed.bin"
# What the page fetches before its first picture, beside mesh, graphs and pictures.
LOADED = (
    "three.module.min.js",
    "three.core.min.js",
    "loaders/GLTFLoader.js",
    "libs/meshopt_decoder.module.js",
    "ort.wasm.bundle.min.mjs",
    "ort.wasm.wasm.gz",
)
LARGEST = 2**30
"""Bytes of weights in float32. ONNX Runtime's WebAssembly has 4 GB of addresses for the file, for what is read from
it, and for the weights unpacked and laid out again; a float32 page also stands in one array of JavaScript, which may
end at 2 GB."""


@dataclass(frozen=True)
class PageReport:
    """What was written: `bytes` of all files, and `model_bytes` of graphs, mesh and lights alone.

    `parity` is that of the float32 graph with torch; `packed` that of the graph as it is in the folder, whose weights
    are whole numbers: how far what the page shows is from float64. `places`: by how much vertices were moved, at most,
    in the unit of the scene. `packed` is None if `exact`, `parity` too if nothing was to be checked. Of a page for
    shaders both are None, and `half` is what its numbers in half precision cost, against float64.
    """

    folder: Path
    bytes: int
    model_bytes: int
    environments: tuple[str, ...]
    parity: onnx.ParityReport | None
    packed: onnx.ParityReport | None
    places: float
    half: float | None = None

    def __str__(self) -> str:
        return (
            f"{self.folder}: {self.bytes / 2**20:.1f} MB, of which model, mesh and lights are "
            f"{self.model_bytes / 2**20:.1f} MB, lights {', '.join(self.environments)}"
        )

    def losses(self) -> str:
        """What is lost against float32, in a sentence; nothing if that was not looked at."""
        if self.half is not None:
            return (
                f"transfer in half precision: radiance is off by {self.half:.1e} of its RMS in the worst light; places "
                f"by {self.places:.1e} at most (--exact keeps float32)"
            )
        if self.packed is None:
            return ""
        return (
            f"weights in 16 bits and fewer: radiance is off by {self.packed.relative_rms:.1e} of its RMS in the worst "
            f"of {self.packed.cases} lights; places by {self.places:.1e} at most (--exact keeps float32)"
        )


def export(
    transfer: Transfer,
    folder: str | os.PathLike[str],
    *,
    environments: Sequence[Environment] | None = None,
    compressed: Transfer | None = None,
    title: str = "torchprt",
    exact: bool = False,
    check: bool = True,
    flight: Flight | None = None,
    gpu: bool = False,
) -> PageReport:
    """Writes a page that shows `transfer` under `environments` (`samples` if none are given) into `folder`.

    Any static web server will do, also in a subfolder; the page asks for nothing that is not in `folder`. It turns
    camera and light, and draws plain N.L, unshadowed irradiance, transfer, `compressed` (the same bake, compressed) if
    given, and the difference of transfer and what approximates it. Glossy transfer follows the eye.
    The graph is compared with torch as by `onnx.export` if `check`. A former page in `folder` is replaced as a whole.

    Of a volume the page composites the source radiance of its cells, which the graph gives, along the rays of its
    camera, in steps between cells as `shade.Composite` does; it shows transfer and `compressed`.

    Of texels it draws the meshes with the map, read between texels, and its gutters.

    `flight`: an object that moves over the model and casts its shadow on it.

    Weights and mesh are quantised (`packing.pack`, `mesh.save_small_glb`), which with gzip makes 100 000 vertices of
    order 5 a download of 6 to 11 MB; with `check` the report says what that costs. `exact` keeps all in float32.

    `gpu`: the page shades in WebGL 2, by the module of `export_three`, and needs no ONNX Runtime: 8 MB less to load.
    Diffuse and exit layers, dense or in clusters; no volumes, and nothing flies.

    Raises InputError if the transfer has no faces or no graph can be made of it, the lights are not of its order,
    `compressed` is another bake, `folder` holds something else, or the libraries cannot be had (see `libraries`).
    """
    target = Path(folder)
    _check_folder(target)
    full = at_rest(transfer)
    volume = None if full.receivers.on_surface else full.receivers.as_cells()
    if volume is not None and flight is not None:
        raise InputError("nothing flies over a volume, which has no surface to cast a shadow on: leave the flight out")
    atlas = full.receivers.as_atlas() if full.receivers.kind == "atlas" else None
    if atlas is not None and flight is not None:
        raise InputError("nothing flies over a map of texels: leave the flight out, or take it to vertices")
    if gpu and (volume is not None or flight is not None):
        raise InputError("a page with gpu shows surfaces on which nothing flies: leave gpu out")
    if len(full.faces) == 0 and volume is None:
        raise InputError("a page shows faces, and this transfer was recorded at loose points: export .onnx")
    packed = None if compressed is None else at_rest(compressed)
    if packed is not None:
        _check_same(full, packed)
    if flight is not None:
        flight.check(full.order)
    for each in (full, packed):
        if each is not None:
            _check_size(each)
    lights = samples(full.order) if environments is None else list(environments)
    if not lights:
        raise InputError("a page needs a light: give one environment or more")
    coefficients = torch.stack([of_order(each, full.order) for each in lights])
    shaded = [shader_file(each, exact=exact) for each in (full, packed) if each is not None] if gpu else []
    half = None
    if gpu and check and not exact:
        half = apart(full, shaded[0].transfer, coefficients)
        if packed is not None:
            half = max(half, apart(packed, shaded[1].transfer, coefficients))
    foreign = libraries()
    with atomic_folder(target) as made:
        page = str(resources.files("torchprt.web") / "page")
        shutil.copytree(page, made, copy_function=shutil.copyfile, dirs_exist_ok=True)
        left_out = shutil.ignore_patterns("ort.*", "onnxruntime-*") if gpu else None
        shutil.copytree(foreign, made / "libraries", copy_function=shutil.copyfile, ignore=left_out)
        parity = packed_parity = None
        if gpu:
            for name, text in ((MODULE, module()), ("runtime.js", gpu_text("runtime.js")), *_without_runtime(made)):
                (made / name).write_text(text, encoding="utf-8")
            for name, file in zip((SHADED, SHADED_COMPRESSED), shaded, strict=False):
                (made / name).write_bytes(file.content)
        else:
            parity = onnx.export(full, made / MODEL, check=check).parity
            packed_parity = None if exact else _pack(made / MODEL, full, check)
        if packed is not None and not gpu:
            onnx.export(packed, made / COMPRESSED, check=check)
            second = None if exact else _pack(made / COMPRESSED, packed, check)
            if packed_parity and second and second.relative_rms > packed_parity.relative_rms:
                packed_parity = second
        names = (MODEL, COMPRESSED, SHADED, SHADED_COMPRESSED)
        models = [_zipped(made / name) for name in names if (made / name).is_file()]
        save = preview.save_glb if exact else save_small_glb
        flies, flying = None, tuple[str, ...]()
        if flight is not None:
            flies, graphs, flying = flight.write(made, save, check)
            models += [_zipped(each) for each in graphs]
        drawn, colour = (full.positions, full.normals, full.faces), _reflectance(full)
        if volume is not None:
            # What is drawn are the sides of its box.
            drawn, colour = box(volume), torch.zeros(8, 3)
        charted = None
        if atlas is not None:
            index, uv, faces = mapped_corners(atlas)
            drawn = (atlas.mesh_positions[index], atlas.mesh_normals[index], faces)
            charted = save_map(atlas, colour, uv, made)
            colour = torch.zeros(len(index), 3)
        moved = save(*drawn, made / "mesh.glb", colour=colour) or 0.0
        cells = None if volume is None else save_volume(volume, made)
        mirrors = full.receivers.mirrors
        if mirrors is not None:
            places, normals, shares, corners = mirrors
            save(places, normals, corners, made / "mirrors.glb", colour=shares)
        camera = preview.frame(preview.subject(full.receivers), aspect=1.0)
        pictures = [_picture(each, made, index) for index, each in enumerate(lights)]
        stops = [round(preview.automatic_exposure(each), 2) for each in coefficients]
        closed = volume is not None or _is_closed(drawn[0], drawn[2])
        about = _about(full, transfer, compressed, title, closed) | {
            "tone": TONE,
            "camera": {"eye": camera.eye, "target": camera.target, "field": camera.field},
            "environments": [
                as_json(each, full.order, picture, exposure)
                for each, picture, exposure in zip(lights, pictures, stops, strict=True)
            ],
        }
        about["mirrors"] = mirrors is not None
        about["flight"] = flies
        about["volume"] = cells
        about["map"] = charted
        meshes = (
            "mesh.glb",
            *((NAME,) if volume is not None else ()),
            *((MAP,) if atlas is not None else ()),
            *(("mirrors.glb",) if mirrors is not None else ()),
            *flying,
        )
        loaded = (
            *meshes,
            *(each.name for each in models if each.name not in (COMPRESSED + ".gz", SHADED_COMPRESSED + ".gz")),
            *(f"libraries/{name}" for name in LOADED if not (gpu and name.startswith("ort."))),
            *((MODULE,) if gpu else ()),
            *pictures,
        )
        about["download"] = sum((made / name).stat().st_size for name in loaded)
        (made / "scene.json").write_text(json.dumps(about, allow_nan=False), encoding="utf-8")
        own = [*models, *(made / name for name in meshes), made / "scene.json", *(made / name for name in pictures)]
        model_bytes = sum(path.stat().st_size for path in own)
    size = sum(path.stat().st_size for path in target.rglob("*") if path.is_file())
    titles = tuple(each.name for each in lights)
    return PageReport(target, size, model_bytes, titles, parity, packed_parity, moved, half)


def _without_runtime(made: Path) -> list[tuple[str, str]]:
    """What of a page speaks of ONNX Runtime, without it."""
    index = (made / "index.html").read_text(encoding="utf-8")
    notice = (made / "NOTICE.txt").read_text(encoding="utf-8")
    preload = '<link rel="modulepreload" href="libraries/ort.wasm.bundle.min.mjs">'
    return [
        ("index.html", index.replace(preload, f'<link rel="modulepreload" href="{MODULE}">')),
        ("NOTICE.txt", notice[: notice.index("libraries/ort.*")].rstrip() + "\n"),
    ]


def _pack(path: Path, transfer: Transfer, check: bool) -> onnx.ParityReport | None:
    """Packs the graph, and says what that has cost if it is to be checked."""
    pack(path)
    return onnx.compare(path, shader(transfer), batches=(1,)) if check else None


def _zipped(path: Path) -> Path:
    """The graph as .gz, which the page unpacks: plain static servers do not compress."""
    zipped = path.with_name(path.name + ".gz")
    zipped.write_bytes(gzip.compress(path.read_bytes(), 6, mtime=0))
    path.unlink()
    return zipped


def _check_folder(target: Path) -> None:
    if target.exists() and not target.is_dir():
        raise InputError(f"{target} is a file: give the name of a folder for the page")
    if target.is_dir() and any(target.iterdir()) and not (target / "scene.json").is_file():
        raise InputError(f"{target} holds something that is no page of torchprt: give another folder")


def _check_size(transfer: Transfer) -> None:
    """Before any work: a browser that runs out of memory shows nothing, and does not say why."""
    size = weight_bytes(transfer)
    if size > LARGEST:
        raise InputError(
            f"a page of {transfer.vertices} receivers unpacks to {size / 2**30:.1f} GB of weights, and a browser holds "
            f"{LARGEST / 2**30:g}: compress the transfer, lower its order or decimate the mesh"
        )


def _check_same(full: Transfer, packed: Transfer) -> None:
    same = (
        full.order == packed.order
        and full.needs == packed.needs
        and torch.equal(full.positions, packed.positions)
        and torch.equal(full.faces, packed.faces)
    )
    if not same:
        raise InputError(
            "the compressed transfer is of another bake, or its vertices are in another order: give what `torchprt "
            "compress` made of this one without --superclusters"
        )


def _reflectance(transfer: Transfer) -> Tensor:
    """What stands for the surface where there is no transfer, `[V, 3]`: black where there is no normal."""
    return torch.where(transfer.normals.abs().sum(-1, keepdim=True) > 0, reflectance(transfer), 0.0)


def _is_closed(positions: Tensor, faces: Tensor) -> bool:
    """Whether two faces meet at every edge, vertices at one place counted as one."""
    _, place = torch.unique(positions, dim=0, return_inverse=True)
    corners = place[faces.long()]
    edges = torch.cat([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]).sort(-1).values
    return bool((torch.unique(edges, dim=0, return_counts=True)[1] == 2).all())


def _picture(environment: Environment, folder: Path, index: int) -> str:
    from PIL import Image

    name = f"environments/{index}.jpg"
    (folder / "environments").mkdir(exist_ok=True)
    values = (shown(environment) * 255).round().to(torch.uint8).numpy()
    write(folder / name, encoded(Image.fromarray(values), format="JPEG", quality=95, subsampling=0))
    return name


def _about(full: Transfer, transfer: Transfer, compressed: Transfer | None, title: str, closed: bool) -> dict[str, Any]:
    bounces = f", {count(full.bounces, 'bounce')}" if full.bounces else ""
    about: dict[str, Any] = {
        "torchprt": VERSION,
        "title": title,
        "subtitle": f"{transfer.kind} transfer, order {full.order}",
        "transport": full.transport + bounces,
        "kind": transfer.kind,
        "order": full.order,
        "vertices": full.vertices,
        "bytes": transfer.bytes,
        "glossy": "eye" in full.needs,
        "closed": closed,
        "full_scale": SHADOWS if compressed is None else COMPRESSION,
        "compressed": None,
    }
    if compressed is not None:
        about["compressed"] = {
            "bytes": compressed.bytes,
            "what": f"{transfer.bytes / compressed.bytes:.1f} times smaller",
        }
    return about
