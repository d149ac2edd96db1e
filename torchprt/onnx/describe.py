"""What an exported file says about itself."""

from __future__ import annotations

import json
import math
import os
from typing import Any

import onnx
from google.protobuf.message import DecodeError

from torchprt.errors import InputError
from torchprt.onnx.operators import count_operators
from torchprt.suffixes import check_readable
from torchprt.transfer import Transfer
from torchprt.transfer.file import CONVENTIONS
from torchprt.version import VERSION

FORMAT = 2

INPUTS = {
    "light": (
        "SH coefficients [B, order^2, 3] of linear RGB incident radiance: real orthonormal basis with the "
        "Condon-Shortley sign, index l(l+1)+m."
    ),
    "environment": (
        "Cube maps [B, 6, H, W, 3] of linear RGB radiance, faces +x -x +y -y +z -z in OpenGL texel orientation."
    ),
    "eye": "Points [B, 3] from which the surfaces are seen, in the frame and unit of the scene.",
    "view": "Directions [B, 3] from the surfaces toward a distant eye, of any length above zero.",
    "frames": (
        "Proper rotation matrices [vertices, 3, 3] of the surface from its rest pose, one a vertex; one pose for all B."
    ),
    "positions": "Points [vertices, 3] where the vertices of the mesh have gone; one pose for all B.",
    "rotation": "Proper rotation matrices [B, 3, 3] that turn the environment; the identity leaves it as it is.",
    "radiance": "Linear RGB exit radiance [B, vertices, 3], albedo applied, before exposure, tone map and sRGB.",
}

# Of graphs that blend lights.
LOCAL = {
    "light": (
        "SH coefficients [B, lights, order^2, 3] of linear RGB incident radiance at the sample points, or with "
        "gradients of every point that and its derivatives along x, y and z; basis and order as of one light."
    ),
    "environment": "Cube maps [B, lights, 6, H, W, 3] about the sample points, each as of one light.",
}

KEYS = (
    "torchprt", "format", "kind", "order", "conventions", "source", "size", "vertices", "channels", "albedo",
    "transport", "bounces", "rays", "seed", "error", "signal", "baked_with",
)  # fmt: skip


def metadata(transfer: Transfer, about: dict[str, Any]) -> dict[str, str]:
    """The `metadata_props` of an exported file: strings, those of `KEYS`, each value as JSON.

    `about`: what the arguments of the export add. `layers` says of each layer its name, its kind and its signal, how
    many receivers it is about, and what it and its signal say of themselves, such as materials and errors. What the
    last one (of those that depend on the eye, if there are any) says stands beside `layers` too.
    Transfer that depends on the eye adds `glossy` (how many receivers that layer is about), `specular` and
    `output_order`.
    """
    last = [*transfer.layers.values(), *transfer.eye_layers.values()][-1]
    entries = {
        "torchprt": VERSION,
        "format": FORMAT,
        "kind": transfer.kind,
        "order": transfer.order,
        "conventions": CONVENTIONS,
        "vertices": transfer.vertices,
        "channels": transfer.channels,
        "albedo": "applied, one for all vertices" if transfer.albedo.shape[0] == 1 else "applied, one a vertex",
        "layers": [
            {"name": each, "kind": layer.kind, "signal": layer.signal.kind, "receivers": layer.signal.shape[0]}
            | layer.signal.metadata()
            | layer.metadata()
            for each, layer in transfer.layers.items()
        ],
        **transfer.provenance,
        **last.signal.metadata(),
        **last.metadata(),
        **about,
        "baked_with": transfer.version,
    }
    del entries["version"]
    if "eye" in last.needs:
        entries["glossy"] = last.signal.shape[0]
        entries["specular"] = "applied, one for all" if len(last.weight) == 1 else "applied, one a receiver"
    if "reflectance" in last.needs:
        entries["output_order"] = math.isqrt(last.signal.shape[2])
    return {key: json.dumps(value) for key, value in entries.items()}


def describe(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a file that `export` wrote says about itself, for people and for programs that run it.

    Its metadata (kind, order, conventions, source, albedo, bounces, provenance; of glossy transfer also projection,
    output order, materials, what the eye is and what is fixed), and read from the graph:
    `inputs` and `outputs` (name -> shape, dynamic sizes as names), `opset`, `operators` (name -> count), `bytes`.

    Raises InputError, naming the file and the fault, if it is missing, truncated, not ONNX, not of this project or
    of a newer format.
    """
    path = check_readable(path, "give a file that `torchprt export` wrote")
    try:
        model = onnx.load(path, load_external_data=False)
    except (DecodeError, OSError) as fault:
        raise InputError(f"{path} is not a whole ONNX file: export it again") from fault
    texts = {entry.key: entry.value for entry in model.metadata_props}
    if "torchprt" not in texts:
        raise InputError(f"{path} is not an ONNX file of torchprt, or it is cut short: give one that `export` wrote")
    try:
        entries: dict[str, Any] = {key: json.loads(text) for key, text in texts.items()}
    except json.JSONDecodeError as fault:
        raise InputError(f"{path} has damaged metadata: export it again") from fault
    if isinstance(entries.get("format"), int) and entries["format"] > FORMAT:
        raise InputError(f"{path} has format {entries['format']}, newer than the {FORMAT} of this torchprt: update it")
    missing = [key for key in KEYS if key not in entries]
    if missing:
        raise InputError(f"{path} lacks the metadata '{missing[0]}': it is cut short, export it again")
    return entries | {
        "inputs": {value.name: shape(value) for value in model.graph.input},
        "outputs": {value.name: shape(value) for value in model.graph.output},
        "opset": {entry.domain: entry.version for entry in model.opset_import}.get("", 0),
        "operators": count_operators(model),
        "bytes": path.stat().st_size,
    }


def shape(value: onnx.ValueInfoProto) -> tuple[int | str, ...]:
    """Sizes of an input or output; a dynamic one by its name."""
    return tuple(size.dim_param or size.dim_value for size in value.type.tensor_type.shape.dim)
