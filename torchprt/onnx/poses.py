"""Poses that are hard on a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchprt.onnx.eyes import Receivers
from torchprt.sh import yaw_pitch_roll
from torchprt.shade import DeformableFactoredShader, DeformableShader, ViewShader


@dataclass
class Posed:
    """`Receivers` in a pose."""

    points: Tensor
    frames: Tensor
    glossy: Tensor


def receivers(shader: ViewShader | DeformableFactoredShader, pose: Mapping[str, Tensor]) -> Receivers:
    """The glossy receivers of a shader, where "positions" or "frames" in `pose` have put them."""
    if isinstance(shader, ViewShader):
        return shader
    points, local, rows = shader.points, shader.local, shader.glossy
    frames = pose.get("frames")
    if "positions" in pose:
        points = pose["positions"].double()[rows].T
        frames = shader.estimate(pose["positions"].double())
    if frames is not None:
        turn = frames.double()[rows]
        local = torch.einsum("gij,kjg->kig", turn, local.double())
    return Posed(points, local, rows)


def random_poses(shader: DeformableShader | DeformableFactoredShader, name: str, seed: int) -> list[dict[str, Tensor]]:
    """Three poses in float32 for the input "frames" or "positions".

    Frames: the identity, half turns about all axes in turn, and a random rotation for every vertex. Positions: the
    rest pose, and the mesh twisted, stretched by different factors and moved by its size, once turned around.
    """
    generator = torch.Generator().manual_seed(seed)
    count = shader.estimate.vertices
    identity = torch.eye(3).expand(count, 3, 3).contiguous()
    if name == "frames":
        half = 180.0 * torch.eye(3)[torch.arange(count) % 3]
        random = 360 * torch.rand(count, 3, generator=generator)
        turned = [yaw_pitch_roll(degrees.double()).float() for degrees in (half, random)]
        return [{name: frames} for frames in (identity, *turned)]
    rest = shader.estimate.rest.double()
    low, high = rest.amin(0), rest.amax(0)
    size = float((high - low).max()) or 1.0
    middle = (rest - (low + high) / 2) / size
    angle = 180 * middle[:, 1]
    twist = yaw_pitch_roll(torch.stack([angle, 0 * angle, 0 * angle], -1))
    twisted = (twist @ (middle * torch.tensor([1.5, 0.7, 1.0]).double()).unsqueeze(-1)).squeeze(-1)
    turn = yaw_pitch_roll(torch.tensor([130.0, 70.0, -40.0]).double())
    poses = [rest, size * (twisted + 1.0), size * (twisted @ turn.mT)]
    return [{name: pose.float()} for pose in poses]
