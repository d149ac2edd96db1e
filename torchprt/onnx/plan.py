"""Which graph an export writes: its module, its inputs, and the shader that it must agree with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.onnx.clustered import BLOCK, ClusteredGraph
from torchprt.onnx.deformable import DeformableGraph, Pose
from torchprt.onnx.deformable_glossy import DeformableGlossyGraph
from torchprt.onnx.eye import Eye
from torchprt.onnx.glossy import FixedLightGraph, GlossyGraph
from torchprt.onnx.graph import Source, make_graph
from torchprt.onnx.parity import Module
from torchprt.shade import (
    DeformableFactoredShader,
    DeformableShader,
    DiffuseShader,
    EnvironmentShader,
    FixedEyeShader,
    FixedLightShader,
    ViewShader,
    shader,
)
from torchprt.shade.view import ViewTransfer
from torchprt.transfer import (
    ClusteredIncidentTransfer,
    ClusteredTransfer,
    ClusteredVisibilityTransfer,
    DiffuseTransfer,
    IncidentTransfer,
    Transfer,
    VisibilityTransfer,
    ZonalFactoredTransfer,
    ZonalTransfer,
)
from torchprt.transfer.clustered import ClusteredLayers, Clusters

Exponent: TypeAlias = float | int | Tensor | None

# protobuf cannot hold 2 GB; a megabyte is left for the nodes. Above it the weights would go to a second file.
LIMIT = 2**31 - 2**20
# Numbers of 4 bytes a vertex from which frames are estimated: eight neighbours and faces, mostly, and its own frame.
ESTIMATE = 48


@dataclass(frozen=True)
class Plan:
    """`inputs`: the shape of one entry of the batch by name; `about`: what the metadata say of the arguments.

    `graph` and `reference` make the float32 module that is traced and the shader in float64. `single`: the inputs that
    have no batch.
    """

    inputs: dict[str, tuple[int, ...]]
    vertices: int
    about: dict[str, Any]
    graph: Callable[[], nn.Module]
    reference: Callable[[], Module]
    single: tuple[str, ...] = ()


def plan(
    transfer: Transfer,
    *,
    source: Source,
    size: int,
    eye: Eye,
    fix_eye: Sequence[float] | Tensor | None,
    fix_light: Tensor | None,
    exponent: Exponent,
    pose: Pose | None = None,
) -> Plan:
    """The graph for the arguments of `export`. Raises InputError if they do not fit together, or it is too large."""
    if source not in ("light", "environment"):
        raise InputError(f"source '{source}' is unknown: use 'light' or 'environment'")
    if source == "environment" and size < 2:
        raise InputError(f"size {size} of the cube map is too small: give at least 2")
    if eye not in ("point", "direction"):
        raise InputError(f"eye '{eye}' is unknown: use 'point' or 'direction'")
    if transfer.vertices == 0:
        raise InputError("the transfer has no vertices: there is nothing to export")
    incident = (6, size, size, 3) if source == "environment" else (transfer.order**2, 3)
    inputs: dict[str, tuple[int, ...]] = {source: incident, "rotation": (3, 3)}
    about: dict[str, Any] = {"source": source, "size": size if source == "environment" else None}
    texels = 6 * size * size * transfer.order**2 if source == "environment" else 0
    if pose is not None and not isinstance(transfer, ZonalTransfer | ZonalFactoredTransfer):
        raise InputError(f"pose is given, but transfer of kind '{transfer.kind}' does not deform: omit it")
    if isinstance(transfer, DiffuseTransfer | ClusteredTransfer | ZonalTransfer):
        given = {
            "eye": None if eye == "point" else eye,
            "fix_eye": fix_eye,
            "fix_light": fix_light,
            "exponent": exponent,
        }
        for name, value in given.items():
            if value is not None:
                raise InputError(f"{name} is given, but diffuse transfer has neither eye nor lobe: omit it")
        if isinstance(transfer, ZonalTransfer):
            return _posed(transfer, inputs, about, source, size, _pose(transfer, pose or "frames"), texels)
        if isinstance(transfer, ClusteredTransfer):
            stored = _representatives(transfer) + transfer.albedo.numel()
        else:
            stored = transfer.transfer.numel() + _apart(transfer.albedo, transfer.channels)
        _check_weights(stored + texels)
        return Plan(
            inputs,
            transfer.vertices,
            about,
            lambda: (
                ClusteredGraph(transfer, source, size)
                if isinstance(transfer, ClusteredTransfer)
                else make_graph(transfer, source, size)
            ),
            lambda: _from(source, size, shader(transfer, dtype=torch.float64)),
        )
    if isinstance(transfer, ZonalFactoredTransfer):
        for name, value in {"fix_eye": fix_eye, "fix_light": fix_light, "exponent": exponent}.items():
            if value is not None:
                raise InputError(f"{name} is given, but transfer of kind '{transfer.kind}' takes eye, light and pose")
        chosen = _pose(transfer, pose or ("positions" if eye == "point" else "frames"))
        return _posed_gloss(transfer, inputs, about, source, size, eye, chosen, texels)
    about |= {"eye": eye, "fixed": None}
    if isinstance(transfer, IncidentTransfer | ClusteredIncidentTransfer):
        if exponent is None:
            raise InputError(
                "transfer of kind 'incident' has no reflectance: give exponent (of a Phong lobe), or export what "
                "shade.with_material makes of it"
            )
        lobe = torch.as_tensor(exponent)
        about["exponent"] = float(lobe) if lobe.numel() == 1 else "one a receiver"
    elif exponent is not None:
        raise InputError(f"exponent is given, but transfer of kind '{transfer.kind}' has its reflectance baked in")
    if fix_eye is not None and fix_light is not None:
        raise InputError("fix_eye and fix_light: nothing is left to change, give one of them")
    name = "eye" if eye == "point" else "view"
    if fix_eye is not None:
        place = _eye(fix_eye)
        colour = max(transfer.channels, transfer.albedo.shape[1], transfer.specular.shape[1])
        _check_weights(colour * transfer.order**2 * transfer.vertices + texels)

        def fixed() -> FixedEyeShader:
            return _shader(transfer, torch.float64, exponent).fix_eye(**{name: place})

        return Plan(
            inputs,
            transfer.vertices,
            about | {"fixed": {name: place.tolist()}},
            lambda: make_graph(_as_diffuse(transfer, fixed()), source, size),
            lambda: _from(source, size, fixed()),
        )
    if not len(transfer.glossy):
        raise InputError("no receiver is glossy, so nothing depends on the eye: give fix_eye, any will do")
    if fix_light is not None:
        if source != "light":
            raise InputError("fix_light is given, so the graph takes no environment: leave source at 'light'")
        light = _light(fix_light, transfer.order)
        _check_weights(3 * (_rows(transfer) * len(transfer.glossy) + transfer.vertices) + _places(transfer))

        def lit() -> FixedLightShader:
            return _shader(transfer, torch.float64, exponent).fix_light(light)

        return Plan(
            {name: (3,)},
            transfer.vertices,
            about | {"source": None, "fixed": "light"},
            lambda: FixedLightGraph(_shader(transfer, torch.float64, exponent), transfer, light, eye),
            lit,
        )
    weights = _stored(transfer) + _apart(transfer.specular, transfer.channels) + _places(transfer)
    weights += transfer.diffuse.numel() + _apart(transfer.albedo, transfer.channels) + texels
    _check_weights(weights, glossy=True)
    return Plan(
        inputs | {name: (3,)},
        transfer.vertices,
        about,
        lambda: GlossyGraph(_shader(transfer, torch.float32, exponent), transfer, source, size, eye),
        lambda: _from(source, size, _shader(transfer, torch.float64, exponent)),
    )


def _posed(
    transfer: ZonalTransfer,
    inputs: dict[str, tuple[int, ...]],
    about: dict[str, Any],
    source: Source,
    size: int,
    pose: Pose,
    texels: int,
) -> Plan:
    """The plan of lobes that turn with the surface."""
    stored = transfer.bytes // transfer.axis.element_size() + _apart(transfer.albedo, transfer.channels) + texels
    _check_weights(stored + (ESTIMATE * transfer.vertices if pose == "positions" else 0))
    return Plan(
        inputs | {pose: _shape(transfer, pose)},
        transfer.vertices,
        about | {"pose": pose},
        lambda: DeformableGraph(shader(transfer, dtype=torch.float32), transfer, source, size, pose),
        lambda: _from(source, size, shader(transfer, dtype=torch.float64)),
        single=(pose,),
    )


def _posed_gloss(
    transfer: ZonalFactoredTransfer,
    inputs: dict[str, tuple[int, ...]],
    about: dict[str, Any],
    source: Source,
    size: int,
    eye: Eye,
    pose: Pose,
    texels: int,
) -> Plan:
    """The plan of glossy lobes that turn with the surface."""
    if pose == "frames" and eye == "point":
        raise InputError(
            "eye is a point and pose is frames, which do not say where the vertices are: give pose='positions', or "
            "eye='direction'"
        )
    if not len(transfer.glossy):
        raise InputError("no receiver is glossy: fit lobes to the diffuse transfer alone")
    stored = transfer.bytes // transfer.axis.element_size() + 12 * len(transfer.glossy) + 6 * transfer.vertices + texels
    _check_weights(stored + (ESTIMATE * transfer.vertices if pose == "positions" else 0))
    name = "eye" if eye == "point" else "view"
    return Plan(
        inputs | {name: (3,), pose: _shape(transfer, pose)},
        transfer.vertices,
        about | {"eye": eye, "fixed": None, "pose": pose},
        lambda: DeformableGlossyGraph(shader(transfer, dtype=torch.float32), transfer, source, size, eye, pose),
        lambda: _from(source, size, shader(transfer, dtype=torch.float64)),
        single=(pose,),
    )


def _pose(transfer: ZonalTransfer | ZonalFactoredTransfer, pose: Pose) -> Pose:
    """`pose`; InputError if it is unknown, cannot be estimated, or there is nothing that it turns."""
    if pose not in ("frames", "positions"):
        raise InputError(f"pose '{pose}' is unknown: use 'frames' or 'positions'")
    if pose == "positions" and not len(transfer.faces):
        raise InputError("the transfer has no faces, from which frames are estimated: use pose='frames'")
    if not transfer.lobes and not transfer.exact.shape[-2]:
        raise InputError("the transfer has no lobes: there is nothing to export")
    return pose


def _shape(transfer: ZonalTransfer | ZonalFactoredTransfer, pose: Pose) -> tuple[int, ...]:
    return (transfer.vertices, 3, 3) if pose == "frames" else (transfer.vertices, 3)


def _shader(transfer: ViewTransfer, dtype: torch.dtype, exponent: Exponent) -> ViewShader:
    module = shader(transfer, dtype=dtype, exponent=exponent)
    assert isinstance(module, ViewShader)
    return module


def _from(
    source: Source, size: int, module: ViewShader | DiffuseShader | DeformableShader | DeformableFactoredShader
) -> Module:
    return EnvironmentShader(module, size) if source == "environment" else module


def _as_diffuse(transfer: ViewTransfer, fixed: FixedEyeShader) -> DiffuseTransfer:
    return DiffuseTransfer(
        transfer=fixed.transfer.detach(),
        albedo=fixed.albedo,
        positions=transfer.positions,
        normals=transfer.normals,
        faces=transfer.faces,
    )


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


def _apart(weight: Tensor, channels: int) -> int:
    """Numbers of a weight that is not folded into what it weighs."""
    return weight.numel() if channels == 1 and weight.shape[1] == 3 else 0


def _places(transfer: ViewTransfer) -> int:
    """Numbers that say where the receivers are: frames and positions, and two for a 64-bit index."""
    return 12 * len(transfer.glossy) + 2 * transfer.vertices


def _rows(transfer: ViewTransfer) -> int:
    if isinstance(transfer, VisibilityTransfer | ClusteredVisibilityTransfer):
        return len(transfer.kernel)
    return transfer.shared.shape[2] if isinstance(transfer, ClusteredLayers) else transfer.matrix.shape[2]


def _stored(transfer: ViewTransfer) -> int:
    """Numbers of the glossy layer."""
    if isinstance(transfer, ClusteredLayers):
        return _representatives(transfer)
    return (transfer.visibility if isinstance(transfer, VisibilityTransfer) else transfer.matrix).numel()


def _representatives(transfer: Clusters) -> int:
    """Numbers of the representatives, and of the weights, at most: blocks are filled, counts rounded up."""
    filled = 2 * (len(transfer.weights) + len(transfer.label)) + BLOCK * len(transfer.basis)
    return transfer.mean.numel() + transfer.basis.numel() + transfer.shared.numel() + filled


def _check_weights(count: int, glossy: bool = False) -> None:
    total = 4 * count
    if total > LIMIT:
        other = ", fix the eye or the light" if glossy else ""
        raise InputError(
            f"the weights are {total / 2**30:.1f} GB, more than the 2 GB that one ONNX file can hold: "
            f"lower the order{other} or split the scene"
        )
