"""Texture patches of zonal lobes on surfaces: read through texture coordinates, turned by tangent frames."""

from __future__ import annotations

from typing import cast

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import normalize

from torchprt.errors import InputError
from torchprt.pose.surface_frames import first_corner, surface_frames, vertex_uv
from torchprt.shade.lobes import turned_axes, turned_exact
from torchprt.transfer import Diffuse, Texels, Transfer, Vertices, Zonal


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
    """A surface covered with a patch (`Texels` with a diffuse layer of zonal lobes), as transfer that is shaded in
    every pose.

    `uv` are texture coordinates, [V, 2] or, a pair for every corner of every face, [F, 3, 2] (`scene.Mesh.uv`); a
    vertex of several charts takes the first. They are multiplied by `repeat` (of u, of v): so many patches lie side by
    side from 0 to 1. Values come from `sample`, and `frames` turn them from the tangent frame to the surface:
    `surface_frames(positions, faces, uv, normals)` if they are not given. Identity frames leave the lobes in the
    tangent frame; the frames of a deformed surface then shade it just as well.

    The surface is taken as flat at the size of the patch: its own shadows and its curvature are not in the result.
    A vertex without a face, or of no normal, gets no light.
    Raises InputError if `patch` is none, there are no texture coordinates, some are missing, or shapes do not fit.
    Source: Sloan, Luna and Snyder 2005, sections 5 and 6 (textures mapped onto any surface).
    """
    _, stored = _parts(patch)
    pairs = vertex_uv(faces, uv, len(positions))
    if frames is None:
        frames = surface_frames(positions, faces, uv, normals)
    if frames.shape != (len(positions), 3, 3):
        raise InputError(f"frames have shape {list(frames.shape)} for {len(positions)} vertices: give [V, 3, 3]")
    dtype = torch.promote_types(stored.axis.dtype, torch.float32)
    scale = repeat if isinstance(repeat, tuple) else (repeat, repeat)
    found, albedo = sample(patch, pairs * pairs.new_tensor(scale))
    frames = frames.to(dtype)
    shown = (frames[..., 2].detach().abs().amax(-1) > 0).to(dtype)
    first = first_corner(faces, len(positions)) < faces.numel()
    shown = shown * first if faces.numel() else shown
    axis = turned_axes(found.axis[0].to(dtype), frames).movedim(0, 1)
    # A frame that has no normal would leave axes without length.
    axis = torch.where(shown > 0, axis, axis.new_tensor([0.0, 0.0, 1.0])[:, None])
    exact = found.exact.to(dtype)[:, 0]
    exact = (turned_exact(exact, frames) if exact.shape[1] else exact) * shown
    signal = found.replace(axis=axis[None], coefficients=found.coefficients.to(dtype) * shown, exact=exact[:, None])
    vertices = Vertices(positions=positions, normals=frames[..., 2], faces=faces)
    layers = {"diffuse": Diffuse(albedo=albedo, signal=signal)}
    return Transfer(receivers=vertices, layers=layers, **patch.provenance)


def sample(patch: Transfer, uv: Float[Tensor, "V 2"]) -> tuple[Zonal, Float[Tensor, "#V #3"]]:
    """The lobes of a patch at texture coordinates, in the tangent frame, and the albedo there.

    Bands 0 and 1 where they are stored apart, and the albedo, are bilinear between the centres of texels; lobes are
    those of the nearest texel, or bilinear too (axes brought back to unit length) if the map is smooth. A map that
    tiles is read modulo 1; else coordinates beyond the centres of its outermost texels read those. Gradients flow to
    the values of the map, and to `uv` from what is bilinear.
    Raises InputError if `patch` is none or a coordinate is not finite.
    Source: Sloan, Luna and Snyder 2005, section 6.
    """
    texels, stored = _parts(patch)
    if not bool(torch.isfinite(uv).all()):
        bad = int((~torch.isfinite(uv)).any(-1).sum())
        raise InputError(f"uv of {bad} points are not finite: give every point a pair of texture coordinates")
    taps, weights = _bilinear(texels, uv)
    nearest = taps.gather(0, weights.argmax(0, keepdim=True))[0]
    axis, coefficients, albedo = stored.axis, stored.coefficients, patch.albedo
    if stored.smooth:
        axis = normalize(_mix(axis, taps, weights), dim=2)
        coefficients = _mix(coefficients, taps, weights)
    else:
        axis, coefficients = axis[..., nearest], coefficients[..., nearest]
    found = stored.replace(
        axis=axis,
        coefficients=coefficients,
        exact=_mix(stored.exact, taps, weights),
        squared_error=stored.squared_error[nearest],
    )
    return found, albedo if len(albedo) == 1 else _mix(albedo.mT, taps, weights).mT


def _parts(patch: Transfer) -> tuple[Texels, Zonal]:
    """The texels and the lobes of a patch. InputError if it has none."""
    texels = patch.receivers.as_texels()
    if "diffuse" not in patch.layers or not patch.layers["diffuse"].signal.follows_pose:
        raise InputError("the patch has no diffuse layer in zonal lobes: fit them to it first")
    return texels, cast(Zonal, patch.layers["diffuse"].signal)


def _bilinear(texels: Texels, uv: Float[Tensor, "V 2"]) -> tuple[Int[Tensor, "4 V"], Float[Tensor, "4 V"]]:
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


def _mix(values: Float[Tensor, "*C T"], taps: Int[Tensor, "4 V"], weights: Float[Tensor, "4 V"]) -> Tensor:
    wide = torch.promote_types(values.dtype, torch.float32)
    mixed = values.new_zeros(*values.shape[:-1], taps.shape[1], dtype=wide)
    for tap, weight in zip(taps, weights.to(wide), strict=True):
        mixed = mixed + values[..., tap] * weight
    return mixed.to(values.dtype)
