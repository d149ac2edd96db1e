"""Which graph an export writes: its module, its inputs, and the shader that it must agree with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.onnx.graph import FixedLightGraph, Pose, ShaderGraph, Source
from torchprt.onnx.parity import Module
from torchprt.onnx.toward_eye import Eye
from torchprt.shade import EnvironmentShader, LocalLightShader, Shader, at_rest, fixed_orders, shader
from torchprt.transfer import Transfer

# protobuf cannot hold 2 GB; a megabyte is left for the nodes. Above it the weights would go to a second file.
LIMIT = 2**31 - 2**20
# Numbers of 4 bytes a vertex from which frames are estimated: eight neighbours and faces, mostly, and its own frame.
ESTIMATE = 48


@dataclass(frozen=True)
class Plan:
    """`inputs`: the shape of one entry of the batch by name; `about`: what the metadata say of the arguments.

    `graph` and `reference` make the float32 module that is traced and the shader in float64. `single`: the inputs that
    have no batch; `lights`: how many the light of an entry is blended of, None if it is one.
    """

    inputs: dict[str, tuple[int, ...]]
    vertices: int
    about: dict[str, Any]
    graph: Callable[[], nn.Module]
    reference: Callable[[], Module]
    single: tuple[str, ...] = ()
    lights: int | None = None


def plan(
    transfer: Transfer,
    *,
    source: Source,
    size: int,
    eye: Eye,
    fix_eye: Sequence[float] | Tensor | None,
    fix_light: Tensor | None,
    exponent: float | int | Tensor | None,
    pose: Pose | None = None,
    orders: Mapping[str, Tensor] | None = None,
    local: bool = False,
) -> Plan:
    """The graph for the arguments of `export`. Raises InputError if they do not fit together, or it is too large."""
    needs = transfer.needs
    _check_words(source, size, eye)
    if transfer.vertices == 0:
        raise InputError("the transfer has no vertices: there is nothing to export")
    _check_given(transfer, {"eye": None if eye == "point" else eye, "fix_eye": fix_eye, "fix_light": fix_light})
    if "reflectance" in needs and exponent is None:
        raise InputError(
            f"transfer of kind '{transfer.kind}' has no reflectance: give exponent (of a Phong lobe), or export what "
            "shade.with_material makes of it"
        )
    if exponent is not None and "reflectance" not in needs:
        raise InputError(f"exponent is given, but transfer of kind '{transfer.kind}' has its reflectance baked in")
    if fix_eye is not None and fix_light is not None:
        raise InputError("fix_eye and fix_light: nothing is left to change, give one of them")
    name = "eye" if eye == "point" else "view"

    def of(held: Transfer, dtype: torch.dtype) -> Shader:
        whole = shader(held, dtype=dtype, exponent=exponent)
        return whole if orders is None else fixed_orders(whole, orders)

    def made(dtype: torch.dtype) -> Shader:
        return of(transfer, dtype)

    places, blend = transfer.receivers.sampled() if local else (None, None)
    if local and fix_light is not None:
        raise InputError("fix_light is given, so the graph takes no light: leave local out")
    lights = None if blend is None else blend.shape[1]
    incident: tuple[int, ...] = (6, size, size, 3) if source == "environment" else (transfer.order**2, 3)
    incident = incident if lights is None else (lights, *incident)
    inputs: dict[str, tuple[int, ...]] = {source: incident, "rotation": (3, 3)}
    about: dict[str, Any] = {"source": source, "size": size if source == "environment" else None}
    if "eye" in needs:
        about |= {"eye": eye, "fixed": None}
    if exponent is not None:
        lobe = torch.as_tensor(exponent)
        about["exponent"] = float(lobe) if lobe.numel() == 1 else "one a receiver"
    if orders is not None:
        about["orders"] = {name: _counts(chosen) for name, chosen in orders.items()}
    if places is not None:
        about |= {"sample_points": places.tolist(), "gradients": lights != len(places)}
    texels = 6 * size * size * transfer.order**2 if source == "environment" else 0
    texels += 0 if blend is None else blend.numel()

    def from_source(module: Shader) -> Module:
        held = module if blend is None else LocalLightShader(module, blend.double())
        return EnvironmentShader(held, size) if source == "environment" else held

    if fix_eye is not None:
        place = {name: _eye(fix_eye)}
        columns = max(max(layer.signal.shape[1], layer.weight.shape[1]) for layer in transfer.layers.values())
        check_weights(columns * transfer.order**2 * transfer.vertices + texels)
        return Plan(
            inputs,
            transfer.vertices,
            about | {"fixed": {key: value.tolist() for key, value in place.items()}},
            lambda: ShaderGraph(made(torch.float64).fix_eye(**place), source, size, eye, None, blend),
            lambda: from_source(made(torch.float64).fix_eye(**place)),
            lights=lights,
        )
    seen = [layer.signal.shape for layer in transfer.eye_layers.values()]
    if seen and not max(shape[0] for shape in seen):
        raise InputError("no receiver is glossy, so nothing depends on the eye: give fix_eye, any will do")
    if fix_light is not None:
        if source != "light":
            raise InputError("fix_light is given, so the graph takes no environment: leave source at 'light'")
        light = _light(fix_light, transfer.order)
        rows = sum(receivers * rows for receivers, _, rows, _ in seen)
        check_weights(3 * rows + 12 * sum(shape[0] for shape in seen) + 5 * transfer.vertices)
        return Plan(
            {name: (3,)},
            transfer.vertices,
            about | {"source": None, "fixed": "light"},
            lambda: FixedLightGraph(made(torch.float64), light, eye),
            lambda: made(torch.float64).fix_light(light),
        )
    if "eye" in needs:
        inputs[name] = (3,)
    chosen = _pose(transfer, eye, pose)
    # Lobes beside a layer that stands still stand still.
    held = transfer if chosen is not None else at_rest(transfer)
    estimated = ESTIMATE * transfer.vertices if chosen == "positions" else 0
    check_weights(_numbers(held) + texels + estimated, glossy="eye" in needs)
    if chosen is not None:
        inputs[chosen] = (transfer.vertices, 3, 3) if chosen == "frames" else (transfer.vertices, 3)
        about["pose"] = chosen
    return Plan(
        inputs,
        transfer.vertices,
        about,
        lambda: ShaderGraph(of(held, torch.float32), source, size, eye, chosen, blend),
        lambda: from_source(made(torch.float64)),
        single=() if chosen is None else (chosen,),
        lights=lights,
    )


def _counts(chosen: Tensor) -> dict[int, int]:
    """How many receivers stand at which order."""
    found, counts = torch.unique(chosen, return_counts=True)
    return dict(zip(found.tolist(), counts.tolist(), strict=True))


def _check_words(source: str, size: int, eye: str) -> None:
    if source not in ("light", "environment"):
        raise InputError(f"source '{source}' is unknown: use 'light' or 'environment'")
    if source == "environment" and size < 2:
        raise InputError(f"size {size} of the cube map is too small: give at least 2")
    if eye not in ("point", "direction"):
        raise InputError(f"eye '{eye}' is unknown: use 'point' or 'direction'")


def _check_given(transfer: Transfer, given: dict[str, Any]) -> None:
    """InputError if an argument about the eye is given that the transfer has no use for."""
    for name, value in given.items():
        if value is None:
            continue
        if "eye" not in transfer.needs:
            raise InputError(
                f"{name} is given, but transfer of kind '{transfer.kind}' does not depend on the eye: omit it"
            )
        if "pose" in transfer.needs and name != "eye":
            raise InputError(
                f"{name} is given, but transfer of kind '{transfer.kind}' takes eye, light and pose: fix the pose "
                "first, with shade.at_rest"
            )


def _pose(transfer: Transfer, eye: Eye, pose: Pose | None) -> Pose | None:
    """How a pose is given; InputError if there is none, it is unknown, cannot be estimated or does not suffice."""
    if "pose" not in transfer.needs:
        if pose is not None:
            raise InputError(f"pose is given, but transfer of kind '{transfer.kind}' does not deform: omit it")
        return None
    point = "eye" in transfer.needs and eye == "point"
    pose = ("positions" if point else "frames") if pose is None else pose
    if pose not in ("frames", "positions"):
        raise InputError(f"pose '{pose}' is unknown: use 'frames' or 'positions'")
    if pose == "positions" and not len(transfer.faces):
        raise InputError("the transfer has no faces, from which frames are estimated: use pose='frames'")
    if pose == "frames" and point:
        raise InputError(
            "eye is a point and pose is frames, which do not say where the vertices are: give pose='positions', or "
            "eye='direction'"
        )
    if not any(layer.signal.bytes for layer in transfer.layers.values()):
        raise InputError("the transfer has no lobes: there is nothing to export")
    return pose


def _eye(given: Sequence[float] | Tensor) -> Tensor:
    place = torch.as_tensor(given, dtype=torch.float64)
    if place.shape != (3,) or not bool(place.isfinite().all()):
        raise InputError(f"fix_eye must be three finite numbers, not {given}")
    return place


def _light(given: Tensor, order: int) -> Tensor:
    if given.shape != (order**2, 3) or not bool(given.isfinite().all()):
        raise InputError(
            f"fix_light has shape {list(given.shape)}: it must be one finite light [{order**2}, 3] of order {order}"
        )
    return given.detach().double()


def _numbers(transfer: Transfer) -> int:
    """Of all layers, their weights and tables, and of where receivers are: frames, positions and an index. Padding of
    clusters is little beside them."""
    parts = [part for layer in transfer.layers.values() for part in (layer, layer.signal)]
    stored = sum(value.numel() for part in parts for name, value in part.tensors().items() if name != "squared_error")
    return stored + sum(12 * layer.signal.shape[0] + 2 * transfer.vertices for layer in transfer.eye_layers.values())


def weight_bytes(transfer: Transfer) -> int:
    """Of the graph of a transfer, in float32."""
    return 4 * _numbers(transfer)


def check_weights(count: int, glossy: bool = False) -> None:
    total = 4 * count
    if total > LIMIT:
        other = ", fix the eye or the light" if glossy else ""
        raise InputError(
            f"the weights are {total / 2**30:.1f} GB, more than the 2 GB that one ONNX file can hold: "
            f"lower the order{other} or split the scene"
        )
