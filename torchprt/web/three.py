"""A folder for a scene of three.js: the model, its transfer for shaders, and the module that draws both."""

from __future__ import annotations

import html
import json
import os
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torchprt import preview
from torchprt.errors import InputError
from torchprt.files import atomic_folder
from torchprt.preview.asset import keep_attributes
from torchprt.preview.asset_source import Asset
from torchprt.preview.environment import Environment
from torchprt.shade import shader
from torchprt.transfer import Transfer
from torchprt.transfer.file import CONVENTIONS
from torchprt.web.environment import as_json, of_order, samples
from torchprt.web.libraries import libraries
from torchprt.web.map import mapped_corners
from torchprt.web.shader_file import shader_file

MODEL, TRANSFER, MODULE = "model.glb", "transfer.bin", "torchprt.js"
# Of three.js, for the example of the folder; a scene of one's own has it already.
THREE = (
    "three.module.min.js",
    "three.core.min.js",
    "loaders/GLTFLoader.js",
    "libs/meshopt_decoder.module.js",
    "utils/BufferGeometryUtils.js",
    "utils/SkeletonUtils.js",
    "three-LICENSE.txt",
)
# What the module is put together from, each after what it imports.
PARTS = ("page/sh.js", "page/project.js", *(
    f"gpu/{name}.js" for name in ("prt", "light", "file", "textures", "shading", "material", "model")
))  # fmt: skip
HEADER = """// torchprt {version}: baked light transfer in scenes of three.js. Copy this file; it imports three alone.
// Made by docs/make/gpu.py from torchprt/web/page and torchprt/web/gpu: change it there. MIT licence.
// docs/gpu.md of torchprt shows how it is used.
"""
_IMPORT = re.compile(r'^import \{([^}]*)\} from "([^"]+)";\n', re.MULTILINE)


@dataclass(frozen=True)
class ThreeReport:
    """What was written: `bytes` of all files, `model_bytes` of mesh and transfer alone, `transfer_bytes` of the latter.

    `error`: what half precision (of attributes: bands that are left out) costs, RMS of radiance relative to its RMS
    against torch in float64, in the worst of the lights; None if nothing was compared.
    """

    folder: Path
    bytes: int
    model_bytes: int
    transfer_bytes: int
    error: float | None

    def __str__(self) -> str:
        lost = "" if self.error is None else f"; radiance is off by {self.error:.1e} of its RMS in the worst light"
        return (
            f"{self.folder}: {self.bytes / 2**20:.1f} MB, of which mesh and transfer are "
            f"{self.model_bytes / 2**20:.1f} MB{lost}"
        )


def module() -> str:
    """The text of `torchprt.js`: one ES module that imports nothing but "three"."""
    from torchprt.version import VERSION

    names: set[str] = set()
    bodies = []
    for part in PARTS:
        text = _text(part)
        names |= {
            name.strip()
            for found, source in _IMPORT.findall(text)
            if source == "three"
            for name in found.split(",")
            if name.strip()
        }
        # Inside of a template.
        functions = re.sub(r"([`\\$])", r"\\\1", _text("gpu/prt.glsl"))
        bodies.append(_IMPORT.sub("", text).replace("@prt.glsl", functions).strip())
    three = "import {\n  " + ",\n  ".join(sorted(names)) + ',\n} from "three";\n'
    return HEADER.format(version=VERSION) + three + "\n" + "\n\n".join(bodies) + "\n"


def gpu_text(name: str) -> str:
    """A file of those that the module and its pages are made of."""
    return _text(f"gpu/{name}")


def _text(name: str) -> str:
    return (resources.files("torchprt.web") / name).read_text(encoding="utf-8")


def export_three(
    transfer: Transfer,
    folder: str | os.PathLike[str],
    *,
    environments: Sequence[Environment] | None = None,
    order: int | None = None,
    asset: Asset | None = None,
    title: str = "torchprt",
    exact: bool = False,
    check: bool = True,
) -> ThreeReport:
    """Writes what a scene of three.js loads of `transfer` into `folder`, with a page that shows it from any web server.

    `model.glb` has the meshes: those of the `asset` that was baked, as `find_asset` gives it, with its skins and
    animations, or a plain one. `transfer.bin` has the transfer for shaders, any order, in half precision (float32 if
    `exact`), at vertices or at texels of a map. With `order`, of 3 or so, there is no `transfer.bin`: the first bands
    are attributes of the vertices, in float32, as `save_transfer_glb` writes them.
    `environments`: the lights of `lights.json`; `samples` if none are given. With `check` the radiance of what shaders
    read is compared with that of the transfer.

    Raises InputError if shaders cannot draw the transfer (`shader_file`), a light has fewer bands, `folder` holds
    something else, or three.js cannot be had (`libraries`).
    """
    target = Path(folder)
    if target.is_dir() and any(target.iterdir()) and not (target / MODULE).is_file():
        raise InputError(f"{target} holds something that no --three wrote: give another folder")
    made = shader_file(transfer, exact=exact) if order is None else None
    lights = samples(transfer.order) if environments is None else list(environments)
    if not lights:
        raise InputError("a scene needs a light: give one environment or more")
    coefficients = torch.stack([of_order(each, transfer.order) for each in lights])
    foreign = libraries()
    read = transfer if made is None else made.transfer
    error = apart(transfer, read if order is None else read.to_order(order), coefficients) if check else None
    with atomic_folder(target) as new:
        (new / MODULE).write_text(module(), encoding="utf-8")
        for name in THREE:
            (new / "libraries" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(foreign / name, new / "libraries" / name)
        if made is None:
            preview.save_transfer_glb(transfer, new / MODEL, order or 3, asset=asset)
        else:
            (new / TRANSFER).write_bytes(made.content)
            _save_model(transfer, new / MODEL, asset)
        (new / "lights.json").write_text(json.dumps(_lights(lights, coefficients, transfer.order)), encoding="utf-8")
        camera = preview.frame(preview.subject(transfer.receivers), aspect=1.0)
        about = {"camera": {"eye": camera.eye, "target": camera.target, "field": camera.field}}
        said = {"title": html.escape(title), "about": json.dumps(about), "load": _load(made is None)}
        page = re.sub(r"@(title|about|load)\b", lambda found: said[found[1]], _text("gpu/index.html"))
        (new / "index.html").write_text(page, encoding="utf-8")
    sizes = {path.relative_to(target).as_posix(): path.stat().st_size for path in target.rglob("*") if path.is_file()}
    stored = sizes.get(TRANSFER, 0)
    return ThreeReport(target, sum(sizes.values()), sizes[MODEL] + stored, stored, error)


def _load(attributes: bool) -> str:
    return 'loadPRTAttributes("./model.glb", new GLTFLoader())' if attributes else 'loadPRT("./", new GLTFLoader())'


def _lights(lights: Sequence[Environment], coefficients: Tensor, order: int) -> dict[str, Any]:
    stops = [round(preview.automatic_exposure(each), 2) for each in coefficients]
    return {"environments": [as_json(each, order, "", stop) for each, stop in zip(lights, stops, strict=True)]}


def _save_model(transfer: Transfer, path: Path, asset: Asset | None) -> None:
    """The meshes, whose vertices say which receivers they are, or where they are on the map."""
    receivers = transfer.receivers
    positions, normals, faces = receivers.surface
    extras = {"torchprt": {"order": transfer.order, "conventions": CONVENTIONS}}
    if receivers.kind == "atlas":
        index, uv, faces = mapped_corners(receivers.as_atlas())
        attributes = {"TEXCOORD_0": uv}
        preview.save_glb(positions[index], normals[index], faces, path, attributes=attributes, extras=extras)
        return
    if receivers.count >= 1 << 24:
        raise InputError(
            f"the transfer has {receivers.count} vertices, and shaders count to {1 << 24}: split the scene"
        )
    numbers = {"_PRT_ID": torch.arange(receivers.count, dtype=torch.float64)[:, None]}
    if asset is not None:
        numbers["_PRT_ALBEDO"] = transfer.albedo.float().expand(receivers.count, 3)
        keep_attributes(asset, transfer, numbers, extras).save(path)
        return
    preview.save_glb(positions, normals, faces, path, attributes=numbers, extras=extras)


def apart(transfer: Transfer, read: Transfer, lights: Tensor) -> float:
    """RMS of what radiance differs by over its RMS, in the worst of `lights [B, N, 3]`, in float64, at rest; `read` may
    be of a lower order."""
    eye = None
    if "eye" in transfer.needs:
        eye = torch.tensor(preview.frame(preview.subject(transfer.receivers), aspect=1.0).eye, dtype=torch.float64)
    worst = 0.0
    with torch.no_grad():
        one, other = (shader(each).double() for each in (transfer, read))
        for light in lights.double():
            lamps = (light[: each.order**2] for each in (one, other))
            a, b = (each(lamp, eye=eye) for each, lamp in zip((one, other), lamps, strict=True))
            size = float(a.square().mean())
            worst = max(worst, float((a - b).square().mean() / size) ** 0.5 if size > 0 else 0.0)
    return worst
