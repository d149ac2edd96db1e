"""Texture patches of zonal lobes on surfaces: read through texture coordinates, turned by tangent frames."""

from __future__ import annotations

from typing import Any, cast

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.errors import InputError
from torchprt.pose.surface_frames import first_corner, surface_frames, vertex_uv
from torchprt.sh import gauss_legendre_hemisphere
from torchprt.shade.eye_layer import EyeLayerModule
from torchprt.shade.layer import layer_module
from torchprt.shade.lobes import turned_axes, turned_exact
from torchprt.shade.signal import Making
from torchprt.transfer import Layer, Texels, Transfer, Vertices, Zonal

# Degree of the rule on whose nodes functions of the eye are compared with their mirror images.
_NODES = 12


def lay(
    patch: Transfer,
    positions: Float[Tensor, "V 3"],
    faces: Int[Tensor, "F 3"],
    uv: Float[Tensor, "..."] | None,
    *,
    repeat: float | int | tuple[float | int, float | int] = 1,
    normals: Float[Tensor, "V 3"] | None = None,
    frames: Float[Tensor, "frames 3 3"] | None = None,
) -> Transfer:
    """A surface covered with a patch (`Texels` with layers in zonal lobes), as transfer that is shaded in every pose.

    `uv` are texture coordinates, [V, 2] or, a pair for every corner of every face, [F, 3, 2] (`scene.Mesh.uv`); a
    vertex of several charts takes the first. They are multiplied by `repeat` (of u, of v): so many patches lie side by
    side from 0 to 1. Values come from `sample`, and `frames` turn them from the tangent frame to the surface:
    `surface_frames(positions, faces, uv, normals)` if they are not given. Identity frames leave the lobes in the
    tangent frame; the frames of a deformed surface then shade it just as well.
    The rows of glossy layers are weighted with functions of the eye in the frames of the relief, which are bilinear
    between texels and turn with the surface; the vertices then have the normals of the relief.

    The surface is taken as flat at the size of the patch: its own shadows and its curvature are not in the result.
    A vertex without a face, or of no normal, gets no light.
    Raises InputError if `patch` is none, if a layer of it is not in lobes, there are no texture coordinates, some are
    missing, or shapes do not fit; or if texture coordinates are mirrored and the functions of the eye of a layer are
    neither even nor odd, so that it cannot be: `PatchShader` reads it there.
    Source: Sloan, Luna and Snyder 2005, sections 5 and 6 (textures mapped onto any surface).
    """
    texels = texels_of(patch)
    pairs = vertex_uv(faces, uv, len(positions))
    if frames is None:
        frames = surface_frames(positions, faces, uv, normals)
    if frames.shape != (len(positions), 3, 3):
        raise InputError(f"frames have shape {list(frames.shape)} for {len(positions)} vertices: give [V, 3, 3]")
    scale = repeat if isinstance(repeat, tuple) else (repeat, repeat)
    pairs = pairs * pairs.new_tensor(scale)
    _check_finite(pairs)
    taps, weights = bilinear(texels, pairs)
    shown = frames[..., 2].detach().abs().amax(-1) > 0
    if faces.numel():
        shown = shown & (first_corner(faces, len(positions)) < faces.numel())
    layers = {name: _laid(layer, texels, taps, weights, frames, shown) for name, layer in patch.layers.items()}
    shining = any("eye" in layer.needs for layer in layers.values())
    up = (frames @ relief(texels, taps, weights).to(frames)[..., None])[..., 0] if shining else frames[..., 2]
    return Transfer(receivers=Vertices(positions=positions, normals=up, faces=faces), layers=layers, **patch.provenance)


def _laid(layer: Layer, texels: Texels, taps: Tensor, weights: Tensor, frames: Tensor, shown: Tensor) -> Layer:
    """A layer of a patch at points of a surface, turned by its frames."""
    signal = cast(Zonal, layer.signal)
    dtype = torch.promote_types(signal.axis.dtype, torch.float32)
    found, frames, lit = _sampled(signal, taps, weights), frames.to(dtype), shown.to(dtype)
    channels, rows = found.coefficients.shape[:2]
    axis = turned_axes(found.axis.to(dtype).flatten(0, 1), frames).movedim(0, 1)
    # A frame that has no normal would leave axes without length.
    axis = torch.where(shown, axis, axis.new_tensor([0.0, 0.0, 1.0])[:, None]).unflatten(0, found.axis.shape[:2])
    exact = found.exact.to(dtype).flatten(0, 1)
    exact = (turned_exact(exact, frames) if exact.shape[1] else exact) * lit
    coefficients, exact = found.coefficients.to(dtype) * lit, exact.unflatten(0, (channels, rows))
    changes: dict[str, Any] = {layer.weight_name: _weight(layer.weight, taps, weights), "receivers": None}
    if "eye" in layer.needs:
        hand = torch.linalg.det(frames.detach()) < 0
        if bool(hand.any()):
            signs = torch.where(hand, _mirrored(layer, texels).to(dtype)[:, None], 1.0)
            coefficients, exact = coefficients * signs[:, None, None], exact * signs[:, None]
        up = relief(texels, taps, weights)
        along = mix(layer.tensors()["tangents"].mT, taps, weights).mT
        along = normalize(along - (along * up).sum(-1, keepdim=True) * up, dim=-1)
        changes["tangents"] = (frames @ along.to(frames)[..., None])[..., 0]
    turned = found.replace(axis=axis, coefficients=coefficients, exact=exact)
    return layer.replace(signal=turned, **changes)


def sample(patch: Transfer, uv: Float[Tensor, "V 2"]) -> tuple[Zonal, Float[Tensor, "#V #3"]]:
    """The diffuse lobes of a patch at texture coordinates, in the tangent frame, and the albedo there.

    Bands 0 and 1 where they are stored apart, and the albedo, are bilinear between the centres of texels; lobes are
    those of the nearest texel, or bilinear too (axes brought back to unit length) if the map is smooth. A map that
    tiles is read modulo 1; else coordinates beyond the centres of its outermost texels read those. Gradients flow to
    the values of the map, and to `uv` from what is bilinear.
    Raises InputError if `patch` is none or a coordinate is not finite.
    Source: Sloan, Luna and Snyder 2005, section 6.
    """
    texels = texels_of(patch)
    if "diffuse" not in patch.layers:
        raise InputError(f"the patch is of kind '{patch.kind}', it has no diffuse layer: lay it with an eye")
    _check_finite(uv)
    taps, weights = bilinear(texels, uv)
    layer = patch.layers["diffuse"]
    return _sampled(cast(Zonal, layer.signal), taps, weights), _weight(layer.weight, taps, weights)


def texels_of(patch: Transfer) -> Texels:
    """The texels of a patch. InputError if it has none, or if a layer cannot be laid on a surface."""
    texels = patch.receivers.as_texels()
    for name, layer in patch.layers.items():
        if not layer.signal.follows_pose:
            raise InputError(f"the patch has no {name} layer in zonal lobes: fit them to it first")
        if layer.receivers is not None:
            raise InputError(f"the {name} layer of the patch is about some of its texels: it must be about all")
    return texels


def _check_finite(uv: Tensor) -> None:
    if not bool(torch.isfinite(uv).all()):
        bad = int((~torch.isfinite(uv)).any(-1).sum())
        raise InputError(f"uv of {bad} points are not finite: give every point a pair of texture coordinates")


def _sampled(stored: Zonal, taps: Tensor, weights: Tensor) -> Zonal:
    """Lobes of texels between them."""
    nearest = nearest_of(taps, weights)
    axis, coefficients, exact = sampled_lobes(
        stored.axis, stored.coefficients, stored.exact, taps, weights, stored.smooth
    )
    return stored.replace(
        axis=axis, coefficients=coefficients, exact=exact, squared_error=stored.squared_error[nearest]
    )


def sampled_lobes(
    axis: Float[Tensor, "M L 3 T"],
    coefficients: Float[Tensor, "C M L Z T"],
    exact: Float[Tensor, "C M J T"],
    taps: Int[Tensor, "4 V"],
    weights: Float[Tensor, "4 V"],
    smooth: bool,
) -> tuple[Float[Tensor, "M L 3 V"], Float[Tensor, "C M L Z V"], Float[Tensor, "C M J V"]]:
    """Axes, coefficients, and bands 0 and 1, as `sample` says."""
    if smooth:
        axis = normalize(mix(axis, taps, weights), dim=2)
        coefficients = mix(coefficients, taps, weights)
    else:
        nearest = nearest_of(taps, weights)
        axis, coefficients = axis[..., nearest], coefficients[..., nearest]
    return axis, coefficients, mix(exact, taps, weights)


def nearest_of(taps: Int[Tensor, "4 V"], weights: Float[Tensor, "4 V"]) -> Int[Tensor, "V"]:
    """Of four texels that with the largest weight."""
    return taps.gather(0, weights.argmax(0, keepdim=True))[0]


def _weight(values: Float[Tensor, "#T D"], taps: Tensor, weights: Tensor) -> Float[Tensor, "#V D"]:
    return values if len(values) == 1 else mix(values.mT, taps, weights).mT


def relief(texels: Texels, taps: Int[Tensor, "4 V"], weights: Float[Tensor, "4 V"]) -> Float[Tensor, "V 3"]:
    """The normals of a relief between its texels, in its tangent frame."""
    return normalize(mix(texels.normals.mT, taps, weights).mT, dim=-1)


def _mirrored(layer: Layer, texels: Texels) -> Float[Tensor, "M"]:
    """1 for every row whose function of the eye is even in the local y, -1 where it is odd. InputError for others."""
    module = layer_module(layer, Making(texels, torch.float64, (), {}))
    assert isinstance(module, EyeLayerModule)
    nodes, weights = gauss_legendre_hemisphere(_NODES)
    there = module.exit_values(nodes)
    opposite = module.exit_values(nodes * nodes.new_tensor([1.0, -1.0, 1.0]))
    signs = torch.where((weights[:, None] * there * opposite).sum(0) < 0, -1.0, 1.0)
    if float((opposite - signs * there).abs().max()) > 1e-2 * float(there.abs().max()):
        raise InputError(
            f"texture coordinates are mirrored, and functions of the eye of the {layer.kind} layer of the patch have "
            "no mirror image among themselves: bake the patch without factors, or read it at every pixel"
        )
    return signs


def bilinear(texels: Texels, uv: Float[Tensor, "V 2"]) -> tuple[Int[Tensor, "4 V"], Float[Tensor, "4 V"]]:
    """The four texels around each point, as numbers of the flattened map, and their weights."""
    rows, columns = texels.rows, texels.columns
    numbers, shares = [], []
    for along, count, tiles in ((uv[:, 0], columns, texels.tiles_u), (uv[:, 1], rows, texels.tiles_v)):
        # Reduced before it is scaled: far tiles keep their digits.
        place = (along - along.detach().floor() if tiles else along.clamp(0, 1)) * count - 0.5
        below = place.detach().floor()
        low = below.long()
        pair = torch.stack([low, low + 1])
        numbers.append(pair % count if tiles else pair.clamp(0, count - 1))
        share = place - below
        shares.append(torch.stack([1 - share, share]))
    taps = (numbers[1][:, None] * columns + numbers[0][None]).flatten(0, 1)
    return taps, (shares[1][:, None] * shares[0][None]).flatten(0, 1)


def mix(values: Float[Tensor, "*C T"], taps: Int[Tensor, "4 V"], weights: Float[Tensor, "4 V"]) -> Tensor:
    """Values of texels between them, bilinear."""
    wide = torch.promote_types(values.dtype, torch.float32)
    mixed = values.new_zeros(*values.shape[:-1], taps.shape[1], dtype=wide)
    for tap, weight in zip(taps, weights.to(wide), strict=True):
        mixed = mixed + values[..., tap] * weight
    return mixed.to(values.dtype)
