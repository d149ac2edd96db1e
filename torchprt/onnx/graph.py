"""The module that is traced into ONNX: a light, turned, on the sum of all layers, toward an eye, in a pose."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from torchprt.onnx.layers import LayerGraph, layer_graph
from torchprt.onnx.toward_eye import Eye
from torchprt.sh import Rotation, cube_basis
from torchprt.shade import Shader

Source = Literal["light", "environment"]
Pose = Literal["frames", "positions"]


class ShaderGraph(nn.Module):
    """`light [B, N, 3]` or environment, `rotation [B, 3, 3]`, what the shader needs, to `radiance [B, V, 3]`, all
    float32.

    The eye is `[B, 3]`. The pose is `frames [V, 3, 3]`, or `positions [V, 3]` from which the graph estimates them; it
    has no batch. Vertices are last until the one Transpose at the end.
    """

    blend: Tensor | None

    def __init__(
        self,
        shader: Shader,
        source: Source,
        size: int,
        eye: Eye,
        pose: Pose | None,
        blend: Tensor | None = None,
    ) -> None:
        """`blend [V, K]`: of how many lights the light is the blend, and how at every vertex."""
        super().__init__()
        self.lights = None if blend is None else blend.shape[1]
        self.receive = LightSource(shader.order, size if source == "environment" else None, self.lights)
        self.register_buffer("blend", None if blend is None else blend.detach().float().T.unsqueeze(1).contiguous())
        self.estimate = shader.estimate if pose == "positions" else None
        layers = [layer for layer in shader.layers.values() if layer.signal.shape[0]]
        made = [layer_graph(layer, shader.vertices, eye, pose is not None) for layer in layers]
        for each in made:
            each.lights = self.lights or 1
        self.layers = nn.ModuleList(made)

    def forward(self, light: Tensor, rotation: Tensor, eye: Tensor | None = None, pose: Tensor | None = None) -> Tensor:
        light = self.receive(light, rotation)
        frames = points = None
        if pose is not None:
            # Frames, or positions of a mesh.
            frames = (pose if self.estimate is None else self.estimate(pose)).permute(1, 2, 0)
            points = None if self.estimate is None else pose.T
        first, *others = (layer(light, eye, frames, points) for layer in self.layers)
        for radiance in others:
            first = first + radiance
        if self.blend is not None:
            assert self.lights is not None
            first = (first.reshape(-1, self.lights, *first.shape[1:]) * self.blend).sum(1)
        return first.mT


class FixedLightGraph(nn.Module):
    """`eye [B, 3]` to `radiance [B, V, 3]` under one light that is inside, all float32."""

    below: Tensor | None

    def __init__(self, shader: Shader, light: Tensor, eye: Eye) -> None:
        """`light [N, 3]`."""
        super().__init__()
        radiance = shader.fix_light(light).radiance
        layers = [layer for layer in shader.layers.values() if "eye" in layer.needs and layer.signal.shape[0]]
        self.layers = nn.ModuleList(layer_graph(layer, shader.vertices, eye, light=light) for layer in layers)
        self.register_buffer("below", None if radiance is None else radiance.detach().float().contiguous())

    def forward(self, eye: Tensor) -> Tensor:
        total = self.below
        for part in self.layers:
            assert isinstance(part, LayerGraph)
            radiance = part.seen(eye)
            total = radiance if total is None else radiance + total
        assert total is not None
        return total.mT


class LightSource(nn.Module):
    """`light [B, N, 3]`, or `environment [B, 6, size, size, 3]`, and `rotation [B, 3, 3]` to the light that shines.

    Of several lights, `[B, K, ...]`, those of one entry after the other: `[B K, N, 3]`.
    """

    weights: Tensor | None

    def __init__(self, order: int, size: int | None, lights: int | None = None) -> None:
        super().__init__()
        self.lights = lights
        self.turn = Rotation(order)
        self.coefficients = order**2
        weights = None if size is None else cube_basis(order, size).to(torch.float32).T.contiguous()
        self.register_buffer("weights", weights)

    def forward(self, light: Tensor, rotation: Tensor) -> Tensor:
        if self.lights is not None:
            light = light.flatten(0, 1)
        if self.weights is not None:
            texels = light.movedim(-1, 1).reshape(-1, self.weights.shape[0])
            light = (texels @ self.weights).reshape(-1, 3, self.coefficients).mT
        if self.lights is None:
            return self.turn(light, rotation)
        # As channels of one light they are turned together.
        sizes = self.lights, self.coefficients
        turned = self.turn(light.reshape(-1, *sizes, 3).transpose(1, 2).flatten(2), rotation)
        return turned.reshape(-1, sizes[1], sizes[0], 3).transpose(1, 2).flatten(0, 1)
