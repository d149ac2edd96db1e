"""Transfer taken from texels to vertices and back, and from one channel to three."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.transfer.atlas import Atlas
from torchprt.transfer.dense import Dense
from torchprt.transfer.layer import Layer
from torchprt.transfer.receivers import Vertices
from torchprt.transfer.transfer import Transfer

NEAR = 1e-4
"""How far the vertices of a transfer may be from those of the meshes of a map, as a share of their size."""
# Numbers of a map that are held at a time.
_NUMBERS = 1 << 25
Read = Callable[[Float[Tensor, "V D"]], Float[Tensor, "W D"]]


def to_vertices(transfer: Transfer) -> Transfer:
    """Transfer of the texels of an atlas at the vertices of the meshes that it lies on.

    A vertex has the mean of what the map has at the corners of its faces, of each side of a seam alike; one that is in
    no face of the map has what the nearest texel has.
    Raises InputError if it is of no atlas, for layers that depend on the eye, and if a signal is compressed.
    """
    atlas = transfer.receivers.as_atlas()
    _check(transfer)
    positions, normals, faces = atlas.surface
    count = len(positions)
    objects = [
        {"name": each["name"], "role": each["role"], "side": "front", "rows": list(each["vertices"])}
        for each in atlas.objects
    ]
    receivers = Vertices(positions=positions, normals=normals, faces=faces, objects=objects)
    placed = atlas.mesh_uv.isfinite().flatten(1).all(-1).nonzero()[:, 0]
    face, weights = placed.repeat_interleave(3), torch.eye(3).to(positions).repeat(len(placed), 1)
    vertex = faces[placed].flatten().long()

    def summed(values: Tensor) -> Tensor:
        return values.new_zeros(count, values.shape[-1]).index_add(0, vertex, atlas.at(values, face, weights))

    # Where there are no gutters a filter reads less than a whole texel at borders.
    covered = summed(positions.new_ones(atlas.count, 1).float())
    lone = (covered[:, 0] < 1e-3).nonzero()[:, 0]
    nearest = _nearest(positions[lone], atlas.positions)

    def read(values: Tensor) -> Tensor:
        found = summed(values) / covered.clamp(min=1e-3).to(values.dtype)
        found[lone] = values[nearest]
        return found

    return _read(transfer, receivers, read, atlas.rows * atlas.columns)


def to_texels(transfer: Transfer, atlas: Atlas) -> Transfer:
    """Transfer of vertices at the texels of an atlas that lies on the same meshes: linear over each face.

    Raises InputError if the transfer is of other vertices than the meshes of `atlas` have, for layers that depend on
    the eye, and if a signal is compressed.
    """
    receivers = transfer.receivers
    if not isinstance(receivers, Vertices):
        raise InputError("the transfer is not recorded at vertices: take it there with transfer.to_vertices first")
    _check(transfer)
    there, meshes = receivers.in_mesh_order(receivers.positions), atlas.mesh_positions
    size = float((meshes.amax(0) - meshes.amin(0)).amax()) if len(meshes) else 0.0
    if there.shape != meshes.shape or float((there - meshes).abs().amax()) > NEAR * size:
        raise InputError(
            f"the transfer was recorded at {len(there)} vertices, and the map lies on meshes of {len(meshes)} that are "
            "not the same: bake both from one scene"
        )
    face, weights = places(atlas)
    corners = atlas.mesh_faces.long()[face]

    def read(values: Tensor) -> Tensor:
        ordered = receivers.in_mesh_order(values)
        return sum((ordered[corners[:, k]] * weights[:, k, None].to(values) for k in range(3)), values.new_zeros(()))

    return _read(transfer, atlas, read, atlas.count)


def with_channels(transfer: Transfer, channels: int) -> Transfer:
    """The same with dense signals of one channel, the mean of three, or of three, the one repeated.

    The mean is what a light without colour has of all three together. Albedo and specular stay as they are.
    Raises InputError unless `channels` is 1 or 3, and if a signal is compressed.
    """
    if channels not in (1, 3):
        raise InputError(f"{channels} channels are asked for: give 1 or 3")
    _check_dense(transfer)
    made = {}
    for name, layer in transfer.layers.items():
        values = layer.signal.dense().values if len(layer.signal.dense().values) != channels else None
        if values is None:
            continue
        if channels == 1:
            values = values.double().mean(0, keepdim=True).to(values.dtype)
        else:
            values = values.expand(3, *values.shape[1:]).contiguous()
        made[name] = layer.replace(signal=Dense(values=values))
    return transfer.with_layers(**made)


def places(atlas: Atlas) -> tuple[Tensor, Tensor]:
    """The face of the meshes that each texel of an atlas lies on `[V]`, and the weights of its corners `[V, 3]`: those
    of the middle of the texel, or of the point beside it if that is not in the chart.

    Of faces that meet in a texel it is the one that comes nearest to where the texel recorded.
    """
    scale = atlas.mesh_uv.new_tensor([atlas.columns, atlas.rows])
    corners = atlas.mesh_uv.double() * scale
    known = corners.isfinite().flatten(1).all(-1)
    corners = corners.nan_to_num(0.0)
    # A texel that a face touches has its middle within half a texel of it.
    low = (corners.amin(1) - 1).floor().clamp(min=0).long()
    high = (corners.amax(1) + 1).ceil().long().minimum(scale.long())
    wide, tall = (high - low).clamp(min=0).unbind(-1)
    number = torch.full((atlas.rows * atlas.columns,), -1, device=corners.device)
    number[atlas.texel.long()] = torch.arange(atlas.count, device=corners.device)
    best = corners.new_full((atlas.count,), torch.inf)
    face = torch.zeros(atlas.count, dtype=torch.long, device=corners.device)
    weights = corners.new_zeros(atlas.count, 3)
    meshes, faces = atlas.mesh_positions.double(), atlas.mesh_faces.long()
    counts = torch.where(known, wide * tall, 0)
    for some in _blocks(counts):
        of = torch.arange(some.start, some.stop, device=corners.device).repeat_interleave(counts[some])
        step = torch.arange(len(of), device=corners.device) - (counts[some].cumsum(0) - counts[some])[of - some.start]
        column, row = low[of, 0] + step % wide[of], low[of, 1] + step // wide[of]
        receiver = number[row * atlas.columns + column]
        of, row, column, receiver = (each[receiver >= 0] for each in (of, row, column, receiver))
        inside = _weights(corners[of], torch.stack([column, row], -1) + 0.5)
        found = (meshes[faces[of]] * inside[..., None]).sum(1)
        away = (found - atlas.positions[receiver].double()).norm(dim=-1)
        least = best.scatter_reduce(0, receiver, away, "amin")
        wins = ((away == least[receiver]) & (away < best[receiver])).nonzero()[:, 0]
        # Of those that are as near the first.
        first = torch.full_like(face, len(faces)).scatter_reduce(0, receiver[wins], of[wins], "amin")
        wins = wins[of[wins] == first[receiver[wins]]]
        best = least
        face[receiver[wins]], weights[receiver[wins]] = of[wins], inside[wins]
    return face, weights.to(atlas.positions.dtype)


def _blocks(counts: Tensor) -> list[slice]:
    """Faces in turn, with about so many texels around them."""
    ends = counts.cumsum(0)
    number = (ends - counts) // (1 << 21)
    starts = [0, *(torch.nonzero(number[1:] != number[:-1])[:, 0] + 1).tolist(), len(counts)]
    return [slice(start, stop) for start, stop in itertools.pairwise(starts) if stop > start]


def _weights(corners: Float[Tensor, "s 3 2"], place: Float[Tensor, "s 2"]) -> Float[Tensor, "s 3"]:
    """Weights of the corners at places, none below zero."""

    def area(a: Tensor, b: Tensor) -> Tensor:
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    a, b, c = (corners[:, k] - place for k in range(3))
    parts = torch.stack([area(b, c), area(c, a), area(a, b)], -1)
    total = parts.sum(-1, keepdim=True)
    parts = torch.where(total.abs() > 0, parts / total, 1 / 3).clamp(min=0)
    return parts / parts.sum(-1, keepdim=True)


def _nearest(points: Float[Tensor, "e 3"], among: Float[Tensor, "V 3"]) -> Tensor:
    found = [torch.cdist(some.double(), among.double()).argmin(1) for some in points.split(256)]
    return torch.cat([torch.zeros(0, dtype=torch.long, device=points.device), *found])


def _read(transfer: Transfer, receivers: Vertices | Atlas, read: Read, numbers: int) -> Transfer:
    """The transfer at other receivers, whose values are read from those that it has; `numbers` that are held of each
    column."""
    layers: dict[str, Layer] = {}
    for name, layer in transfer.layers.items():
        values = layer.signal.dense().values
        columns = values.flatten(0, 1).split(max(1, _NUMBERS // numbers))
        made = torch.cat([read(some.mT).mT for some in columns]).unflatten(0, values.shape[:2]).contiguous()
        weight = layer.weight if len(layer.weight) == 1 else read(layer.weight.float()).clamp(0, 1)
        layers[name] = layer.replace(signal=Dense(values=made.to(values.dtype)), **{layer.weight_name: weight})
    return dataclasses.replace(transfer, receivers=receivers, layers=layers)


def _check(transfer: Transfer) -> None:
    _check_dense(transfer)
    for name, layer in transfer.layers.items():
        if layer.needs:
            raise InputError(
                f"layer '{name}' of the transfer has matrices in the frame of each of its receivers, which are not "
                "blended: bake the scene where it is wanted"
            )
        if layer.receivers is not None:
            raise InputError(f"layer '{name}' of the transfer is of some of its receivers: bake where it is wanted")


def _check_dense(transfer: Transfer) -> None:
    for name, layer in transfer.layers.items():
        if not isinstance(layer.signal, Dense):
            raise InputError(
                f"layer '{name}' of the transfer is stored as {layer.signal.kind}, which is not blended: take the bake "
                "that it was made of, or compression.decompress, and compress the result"
            )
