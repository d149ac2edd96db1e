"""The pose that a bake in zonal lobes is shaded in, from meshes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from torchprt.cli.report import say
from torchprt.errors import InputError
from torchprt.words import count

if TYPE_CHECKING:
    from torch import Tensor

    from torchprt.transfer import Transfer


def in_pose(transfer: Transfer, meshes: Sequence[Path]) -> tuple[Transfer, dict[str, Tensor]]:
    """The transfer with the places and normals of the pose, to be drawn, and the keyword of the shader.

    The meshes follow each other as they did when they were baked; reverse sides go with the first ones. Raises
    InputError if the transfer cannot deform, or the meshes have other vertices or faces than it.
    """
    import torch

    from torchprt.pose import deformed_frames
    from torchprt.scene import read_mesh

    if "pose" not in transfer.needs:
        raise InputError(
            f"--pose is given, but transfer of kind '{transfer.kind}' has one pose: fit lobes first, with torchprt fit"
        )
    read = [read_mesh(path) for path in meshes]
    names = ", ".join(str(path) for path in meshes)
    starts = [sum(len(mesh.positions) for mesh in read[:index]) for index in range(len(read))]
    positions = torch.cat([mesh.positions for mesh in read])
    faces = torch.cat([mesh.faces + start for mesh, start in zip(read, starts, strict=True)])
    receivers = _receivers(transfer.positions.double(), len(positions))
    if receivers is None:
        raise InputError(
            f"{names} has {len(positions)} vertices but the bake {transfer.vertices}: give the mesh that was baked, "
            "with only its vertices moved"
        )
    if not torch.equal(transfer.faces[: len(faces)].long(), faces):
        raise InputError(
            f"{names} has other faces than the bake: give the mesh that was baked, with its vertices moved"
        )
    a, b, c = positions[faces].unbind(1)
    collapsed = int((torch.linalg.cross(b - a, c - a) == 0).all(1).sum())
    if collapsed:
        say(f"{names}: {count(collapsed, 'face')} collapsed, their neighbours say how the surface has turned")
    posed = positions[receivers]
    frames = deformed_frames(transfer.positions.double(), transfer.faces, posed, normals=transfer.normals.double())
    normals = (frames @ transfer.normals.double().unsqueeze(-1)).squeeze(-1)
    moved = transfer.receivers.replace(positions=posed, normals=normals.to(transfer.normals.dtype))
    drawn = dataclasses.replace(transfer, receivers=moved)
    return drawn, {"positions": posed}


def _receivers(rest: Tensor, count: int) -> Tensor | None:
    """The vertex of each receiver: the first ones are the vertices, reverse sides are where a first one is at rest."""
    import torch
    from scipy.spatial import cKDTree

    if not 0 < count <= len(rest):
        return None
    away, nearest = cKDTree(rest[:count].numpy()).query(rest[count:].numpy()) if count < len(rest) else ([], [])
    if any(away):
        return None
    return torch.cat([torch.arange(count), torch.as_tensor(nearest, dtype=torch.int64)])
