"""The modules that are traced into ONNX for glossy surfaces: what they send depends on the eye."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from torchprt.onnx.clustered import ClusteredLayer, FixedTable, in_blocks
from torchprt.onnx.eye import Eye, EyeGraph
from torchprt.onnx.graph import DiffuseGraph, Source, fold, make_graph
from torchprt.shade import FactoredShader, FixedLightShader, ViewShader
from torchprt.shade.clustered import ClusteredMatrix
from torchprt.shade.glossy import MatrixShader
from torchprt.shade.view import ViewTransfer
from torchprt.transfer import DiffuseTransfer
from torchprt.transfer.clustered import ClusteredLayers


class GlossyGraph(nn.Module):
    """`light [B, N, 3]` or environment, `rotation [B, 3, 3]`, `eye [B, 3]` to `radiance [B, V, 3]`, all float32.

    The diffuse layer, and over it the glossy one in the exit functions of `shader`.
    """

    def __init__(self, shader: ViewShader, transfer: ViewTransfer, source: Source, size: int, eye: Eye) -> None:
        super().__init__()
        self.diffuse: DiffuseGraph = make_graph(diffuse_layer(transfer), source, size)
        if isinstance(transfer, ClusteredLayers):
            shader = in_blocks(shader, transfer)
        self.eye = EyeGraph(shader.frames, shader.points if eye == "point" else None)
        self.exits = exit_graph(shader)
        self.layer = _layer(shader)
        self.spread = Spread(shader.glossy, shader.vertices)

    def forward(self, light: Tensor, rotation: Tensor, eye: Tensor) -> Tensor:
        light = self.diffuse.receive(light, rotation)
        radiance = self.spread(self.layer(light, self.exits(self.eye(eye)))).mT
        return radiance + self.diffuse.reflect(light) if self.diffuse.vertices else radiance


class FixedLightGraph(nn.Module):
    """`eye [B, 3]` to `radiance [B, V, 3]` under one light that is inside, all float32."""

    diffuse: Tensor | None

    def __init__(self, shader: ViewShader, transfer: ViewTransfer, light: Tensor, eye: Eye) -> None:
        """`light [N, 3]`."""
        super().__init__()
        fixed = shader.fix_light(light.to(shader.specular.dtype))
        if isinstance(shader, ClusteredMatrix) and isinstance(transfer, ClusteredLayers):
            shader = in_blocks(shader, transfer)
            self.layer: nn.Module = FixedTable(ClusteredLayer(shader), light)
        else:
            self.layer = FixedCoefficients(fixed)
        self.eye = EyeGraph(shader.frames, shader.points if eye == "point" else None)
        self.exits = exit_graph(shader)
        self.register_buffer("diffuse", None if fixed.radiance is None else fixed.radiance.float().contiguous())
        self.spread = Spread(shader.glossy, shader.vertices)

    def forward(self, eye: Tensor) -> Tensor:
        radiance = self.spread(self.layer(self.exits(self.eye(eye))))
        return (radiance if self.diffuse is None else radiance + self.diffuse).mT


class FixedCoefficients(nn.Module):
    """Exit values `[B, M, G]` to radiance `[B, 3, G]` under one light that is inside."""

    coefficients: Tensor

    def __init__(self, fixed: FixedLightShader) -> None:
        super().__init__()
        self.register_buffer("coefficients", fixed.coefficients.float().contiguous())

    def forward(self, values: Tensor) -> Tensor:
        return (self.coefficients * values.unsqueeze(1)).sum(2)


class ExitGraph(nn.Module):
    """Values `[B, M, G]` of the exit functions of a shader at local directions `[3, B, G]`."""

    def __init__(self, shader: ViewShader) -> None:
        super().__init__()
        # Not a submodule: of its tensors only those that the functions read belong to the graph.
        self.values = shader.exit_values

    def forward(self, local: Tensor) -> Tensor:
        return self.values(local.movedim(0, -1)).mT


class FactorGraph(nn.Module):
    """Values `[B, M, G]` at local directions `[3, B, G]` of factors in a table: `brdf.sample_hemisphere_map`.

    Without Sign, Floor and GatherND, which `ALLOWED` leaves out.
    """

    texels: Tensor

    def __init__(self, factors: Tensor) -> None:
        """`factors [M, H, H]`."""
        super().__init__()
        self.size = factors.shape[-1]
        self.register_buffer("texels", factors.flatten(1).float().contiguous())

    def forward(self, local: Tensor) -> Tensor:
        x, y, z = local.unbind(0)
        shrink = torch.sqrt(1 / (1 + z))
        x, y = x * shrink, y * shrink
        wide = x * x > y * y
        longer, shorter = torch.where(wide, x, y), torch.where(wide, y, x)
        squared = x * x + y * y
        off = squared > 0
        length = torch.sqrt(torch.where(off, squared, 1.0))
        radius = torch.where(off, torch.where(longer > 0, length, -length), 0.0)
        other = radius * torch.atan(shorter / torch.where(off, longer, 1.0)) * (4 / math.pi)
        across, along = (
            (part + 1) * (self.size / 2) - 0.5
            for part in (torch.where(wide, radius, other), torch.where(wide, other, radius))
        )
        column, row = (place.clamp(0, self.size - 2).long() for place in (across, along))
        right, down = (across - column.float()).reshape(-1), (along - row.float()).reshape(-1)
        first = (row * self.size + column).reshape(-1)
        rows = [self._at(first + step, right) for step in (0, self.size)]
        values = rows[0] + down * (rows[1] - rows[0])
        return values.reshape(len(self.texels), -1, local.shape[-1]).movedim(0, 1)

    def _at(self, index: Tensor, right: Tensor) -> Tensor:
        texel, following = self.texels.index_select(1, index), self.texels.index_select(1, index + 1)
        return texel + right * (following - texel)


def exit_graph(shader: ViewShader) -> ExitGraph | FactorGraph:
    return FactorGraph(shader.factors) if isinstance(shader, FactoredShader) and not shader.views else ExitGraph(shader)


def _layer(shader: ViewShader) -> nn.Module:
    if isinstance(shader, ClusteredMatrix):
        return ClusteredLayer(shader)
    return MatrixLayer(shader) if isinstance(shader, MatrixShader) else VectorLayer(shader)


class MatrixLayer(nn.Module):
    """Exit matrices: `light [B, N, 3]`, turned, and exit values `[B, M, G]` to radiance `[B, 3, G]`.

    The light first, as one product that streams the matrices `[N, M G]` once, then a weighted sum over M. In ONNX
    Runtime at G = 25 000, M = N = 25, one thread: 2.8 ms for one light and eye and 27 ms for 16. The view first, G
    products `[B, M] @ [M, N]` and then the lights, takes 4.9 and 23 ms, or 6.7 and 68 as `[N, M] @ [M, B]`. While it
    runs it needs 24 M G bytes a light.
    """

    matrix: Tensor
    specular: Tensor | None

    def __init__(self, shader: MatrixShader) -> None:
        super().__init__()
        channels, self.receivers, self.rows, columns = shader.matrix.shape
        streams = shader.matrix.permute(0, 3, 2, 1).reshape(channels, columns * self.rows, self.receivers)
        streams, specular = fold(streams, shader.specular)
        self.register_buffer("matrix", streams.reshape(channels, columns, self.rows * self.receivers))
        self.register_buffer("specular", specular)

    def forward(self, light: Tensor, values: Tensor) -> Tensor:
        channels, columns, _ = self.matrix.shape
        if channels == 3:
            exits = (light.permute(2, 0, 1) @ self.matrix).reshape(3, -1, self.rows, self.receivers)
            return (exits * values).sum(2).movedim(0, 1)
        exits = (light.mT.reshape(-1, columns) @ self.matrix[0]).reshape(-1, 3, self.rows, self.receivers)
        radiance = (exits * values.unsqueeze(1)).sum(2)
        return radiance if self.specular is None else radiance * self.specular


class VectorLayer(nn.Module):
    """The transfer vectors of a shader: `light [B, N, 3]`, turned, and exit values `[B, M, G]` to radiance `[B, 3, G]`.

    For visibility, whose matrices exist nowhere. The tables of the rule and, up to a megabyte, what only depends on
    them are constants of the graph; a runtime folds the rest when it opens the file.
    """

    specular: Tensor

    def __init__(self, shader: ViewShader) -> None:
        super().__init__()
        self.vectors = shader.vectors
        self.register_buffer("specular", shader.specular.T.contiguous())

    def forward(self, light: Tensor, values: Tensor) -> Tensor:
        return (light.mT @ self.vectors(values.mT)[0]) * self.specular


class Spread(nn.Module):
    """Radiance `[B, 3, G]` of the glossy receivers to `[B, 3, V]`, zero elsewhere.

    Zeros are added behind the G and a Gather puts all in their places: a Scatter is a loop in some runtimes.
    """

    place: Tensor | None
    zero: Tensor

    def __init__(self, glossy: Tensor, vertices: int) -> None:
        super().__init__()
        place = torch.full((vertices,), len(glossy)).index_put((glossy,), torch.arange(len(glossy)))
        whole = torch.equal(place, torch.arange(len(glossy)))
        self.register_buffer("place", None if whole else place)
        self.register_buffer("zero", torch.zeros(1, 1, 1))

    def forward(self, radiance: Tensor) -> Tensor:
        if self.place is None:
            return radiance
        padded = torch.cat([radiance, self.zero.expand(radiance.shape[0], 3, 1)], -1)
        return padded.index_select(-1, self.place)


def diffuse_layer(transfer: ViewTransfer) -> DiffuseTransfer:
    """The diffuse layer alone; without vertices if there is none."""
    vertices = transfer.diffuse.shape[2]
    return DiffuseTransfer(
        transfer=transfer.diffuse,
        albedo=transfer.albedo if vertices else transfer.albedo.new_ones(1, 1),
        positions=transfer.positions[:vertices],
        normals=transfer.normals[:vertices],
        faces=transfer.faces,
    )
