"""Poses that are hard on a graph."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from torchprt.onnx.hard_eyes import Seen
from torchprt.sh import yaw_pitch_roll
from torchprt.shade import EyeLayerModule, FixedLightShader, Shader


def receivers(shader: Shader | FixedLightShader, layer: EyeLayerModule, pose: Mapping[str, Tensor]) -> Seen:
    """The receivers of a layer of a shader, where "positions" or "frames" in `pose` have put them."""
    points, local = layer.points, layer.frames
    given = {name: pose[name].double() for name in ("frames", "positions") if name in pose}
    if given and isinstance(shader, Shader):
        turned = shader.pose(given.get("frames"), given.get("positions"))
        assert turned is not None
        local = torch.einsum("gij,kjg->kig", layer.among(turned, 0), local.double())
        if "positions" in given:
            points = layer.among(given["positions"], 0).T
    return Seen(points, local)


def random_poses(shader: Shader, name: str, seed: int) -> list[dict[str, Tensor]]:
    """Three poses in float32 for the input "frames" or "positions".

    Frames: the identity, half turns about all axes in turn, and a random rotation for every vertex. Positions: the
    rest pose, and the mesh twisted, stretched by different factors and moved by its size, once turned around.
    """
    generator = torch.Generator().manual_seed(seed)
    assert shader.estimate is not None
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
