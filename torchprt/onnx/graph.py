"""The modules that are traced into ONNX: the mathematics of the shaders in the layout that runs fastest there."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from torchprt.sh import Rotation, cube_basis
from torchprt.transfer import DiffuseTransfer

Source = Literal["light", "environment"]


class DiffuseGraph(nn.Module):
    """`light [B, N, 3]`, `rotation [B, 3, 3]` to `radiance [B, V, 3]`, all float32.

    What `DiffuseShader` computes, with the albedo folded into the transfer vectors wherever that stores nothing
    more. Vertices are last until the one Transpose at the end: the product then streams the transfer once, which
    ONNX Runtime runs about twice as fast as `[V, N] @ [N, 3]`.
    """

    transfer: Tensor
    albedo: Tensor | None

    def __init__(self, transfer: DiffuseTransfer) -> None:
        super().__init__()
        vectors, albedo = fold(transfer.transfer, transfer.albedo)
        self.register_buffer("transfer", vectors[0] if len(vectors) == 1 else vectors)
        self.register_buffer("albedo", albedo)
        self.turn = Rotation(transfer.order)
        self.coefficients = transfer.order**2
        self.vertices = transfer.vertices

    def forward(self, light: Tensor, rotation: Tensor) -> Tensor:
        return self.reflect(self.receive(light, rotation))

    def receive(self, light: Tensor, rotation: Tensor) -> Tensor:
        """The light `[B, N, 3]` that shines, from the inputs."""
        return self.turn(light, rotation)

    def reflect(self, light: Tensor) -> Tensor:
        """Radiance `[B, V, 3]` under the turned light."""
        if self.transfer.ndim == 3:
            return (light.permute(2, 0, 1) @ self.transfer).permute(1, 2, 0)
        if self.albedo is not None and self.albedo.shape[1] == 1:
            light = light * self.albedo.T
        radiance = (light.mT.reshape(-1, self.coefficients) @ self.transfer).reshape(-1, 3, self.vertices)
        if self.albedo is not None and self.albedo.shape[1] != 1:
            radiance = radiance * self.albedo
        return radiance.mT


class EnvironmentGraph(DiffuseGraph):
    """`environment [B, 6, size, size, 3]`, `rotation [B, 3, 3]` to `radiance [B, V, 3]`, all float32."""

    weights: Tensor

    def __init__(self, transfer: DiffuseTransfer, size: int) -> None:
        super().__init__(transfer)
        self.register_buffer("weights", cube_basis(transfer.order, size).to(torch.float32).T.contiguous())

    def forward(self, environment: Tensor, rotation: Tensor) -> Tensor:
        return self.reflect(self.receive(environment, rotation))

    def receive(self, environment: Tensor, rotation: Tensor) -> Tensor:
        """The light `[B, N, 3]` that shines, from the inputs."""
        texels = environment.movedim(-1, 1).reshape(-1, self.weights.shape[0])
        light = (texels @ self.weights).reshape(-1, 3, self.coefficients).mT
        return super().receive(light, rotation)


def fold(vectors: Tensor, weight: Tensor) -> tuple[Tensor, Tensor | None]:
    """`vectors [C, K, V]` times `weight [V or 1, 3 or 1]` in float32, and the weight `[3, V or 1]` if it stays apart.

    RGB weights over single-channel vectors do: folding them would store three times as much.
    """
    vectors, weight = vectors.detach(), weight.detach()
    if weight.shape[1] == 3 and len(vectors) == 1:
        return vectors.float().contiguous(), weight.T.float().contiguous()
    wide = torch.promote_types(torch.promote_types(vectors.dtype, weight.dtype), torch.float32)
    return (vectors.to(wide) * weight.T[:, None].to(wide)).float().contiguous(), None


def make_graph(transfer: DiffuseTransfer, source: Source, size: int) -> DiffuseGraph:
    return DiffuseGraph(transfer) if source == "light" else EnvironmentGraph(transfer, size)
