"""Eyes and poses that are hard on a graph, and how much rounding an eye magnifies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from torchprt.sh import yaw_pitch_roll
from torchprt.shade import EyeLayerModule, FixedLightShader, PhaseLayer, Shader

FAR = 1e4
# Of eyes, in turn.
KINDS = 6


@dataclass(frozen=True)
class Seen:
    """The receivers of a layer that depends on the eye, in a pose: `points [3, G]`, local frames `[3, 3, G]`; whether
    they have a `horizon`, under which nothing is seen."""

    points: Tensor
    frames: Tensor
    horizon: bool = True


def random_eyes(seen: Seen, name: str, count: int, generator: torch.Generator) -> Tensor:
    """Float32 eyes `[count, 3]` for the input "eye" or "view", of every kind in turn.

    Points: two sizes of the model away, near a glossy receiver (a hundredth of the size), far, in the middle, at a
    receiver, and behind one, under its tangent plane. Directions: random ones of length 1, 1e-6, 1e6, along the normal
    of a receiver and against it, and one that grazes it.
    """
    places, (tangents, _, normals) = seen.points.T, seen.frames.permute(0, 2, 1)
    random = torch.randn(count, 3, generator=generator, dtype=torch.float64)
    random = random / random.norm(dim=-1, keepdim=True)
    if not len(places):
        return random.float()
    chosen = torch.randint(len(places), (count,), generator=generator)
    place, normal, tangent = places[chosen], normals[chosen].double(), tangents[chosen].double()
    if name == "view":
        kinds = [random, 1e-6 * random, 1e6 * random, normal, 0.5 * tangent - normal, tangent]
    else:
        low, high = places.amin(0), places.amax(0)
        middle, size = (low + high) / 2, float((high - low).norm()) or 1.0
        kinds = [
            middle + 2 * size * random,
            place + 0.01 * size * random,
            middle + FAR * size * random,
            middle + 0.05 * size * random,
            place,
            place + size * (0.2 * tangent - 0.3 * normal),
        ]
    # The lights repeat every 8, the kinds every 6: all meet.
    return torch.stack([kinds[index % len(kinds)][index] for index in range(count)]).float()


def eyes_of_all(layers: list[Seen], name: str, count: int, generator: torch.Generator) -> Tensor:
    """Eyes `[count, 3]` as `random_eyes` has them, those of one layer after those of another; every kind meets every
    layer as far as `count` reaches. Layers without receivers have none."""
    seen = [layer for layer in layers if layer.points.shape[1]] or layers[:1]
    eyes = [random_eyes(layer, name, count, generator) for layer in seen]
    return torch.stack([eyes[(index + index // KINDS) % len(eyes)][index] for index in range(count)])


def conditions(seen: Seen, eye: Tensor | None, view: Tensor | None) -> Tensor:
    """For each glossy receiver `[G]`, the sine of the angle from straight below to the eye; 1 above the horizon.

    `eye [3]` or `view [3]`, float64. Below, rounding of the direction by one unit turns what is seen by one over it.
    """
    if eye is None:
        assert view is not None
        toward = view.expand(seen.points.shape[1], 3)
    else:
        toward = eye - seen.points.T
    if not seen.horizon:
        return torch.ones(len(toward), dtype=toward.dtype)
    largest = toward.abs().amax(-1, keepdim=True)
    toward = toward / torch.where(largest > 0, largest, math.inf)
    x, y, z = (seen.frames.permute(2, 0, 1) @ toward.unsqueeze(-1)).squeeze(-1).unbind(-1)
    across, length = torch.hypot(x, y), toward.norm(dim=-1)
    return torch.where(z < 0, across / torch.where(length > 0, length, 1.0), 1.0)


def receivers(
    shader: Shader | FixedLightShader, layer: EyeLayerModule | PhaseLayer, pose: Mapping[str, Tensor]
) -> Seen:
    """The receivers of a layer of a shader, where "positions" or "frames" in `pose` have put them."""
    points, local = layer.points, layer.frames
    given = {name: pose[name].double() for name in ("frames", "positions") if name in pose}
    if given and isinstance(shader, Shader):
        turned = shader.pose(given.get("frames"), given.get("positions"))
        assert turned is not None
        local = torch.einsum("gij,kjg->kig", layer.among(turned, 0), local.double())
        if "positions" in given:
            points = layer.among(given["positions"], 0).T
    return Seen(points, local, isinstance(layer, EyeLayerModule))


def random_poses(shader: Shader | FixedLightShader, name: str, seed: int) -> list[dict[str, Tensor]]:
    """Three poses in float32 for the input "frames" or "positions".

    Frames: the identity, half turns about all axes in turn, and a random rotation for every vertex. Positions: the
    rest pose, and the mesh twisted, stretched by different factors and moved by its size, once turned around.
    """
    generator = torch.Generator().manual_seed(seed)
    assert isinstance(shader, Shader)
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
