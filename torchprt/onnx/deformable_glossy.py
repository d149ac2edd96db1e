"""The module that is traced into ONNX for glossy surfaces that deform: an eye and a pose are inputs."""

from __future__ import annotations

from torch import Tensor, nn

from torchprt.onnx.deformable import LobeGraph, Pose, PoseGraph, without_vertices
from torchprt.onnx.eye import NOTHING, Eye, above_horizon, scaled
from torchprt.onnx.glossy import FactorGraph, Spread
from torchprt.onnx.graph import Source, make_graph
from torchprt.shade import DeformableFactoredShader
from torchprt.transfer import ZonalFactoredTransfer


class DeformableGlossyGraph(nn.Module):
    """`light [B, N, 3]` or environment, `rotation [B, 3, 3]`, `eye [B, 3]` and a pose to `radiance [B, V, 3]`.

    The pose has no batch, as in `DeformableGraph`: what a row of the matrix sends under a light is made once, and each
    eye weighs the rows. A pose of frames has no positions, so it takes directions toward the eye alone.
    """

    glossy: Tensor | None
    specular: Tensor
    albedo: Tensor | None

    def __init__(
        self,
        shader: DeformableFactoredShader,
        transfer: ZonalFactoredTransfer,
        source: Source,
        size: int,
        eye: Eye,
        pose: Pose,
    ) -> None:
        super().__init__()
        self.source = make_graph(without_vertices(transfer), source, size)
        self.pose = PoseGraph(shader.estimate if pose == "positions" else None)
        rows = zip(shader.axis, shader.coefficients.unbind(1), shader.exact.unbind(1), strict=True)
        self.rows = nn.ModuleList(LobeGraph(*row) for row in rows)
        self.exits = FactorGraph(shader.factors)
        self.eye = PosedEyeGraph(shader.local, eye)
        self.spread = Spread(shader.glossy, shader.vertices)
        self.register_buffer("glossy", shader.glossy.int() if len(shader.glossy) < shader.vertices else None)
        self.register_buffer("specular", shader.specular.T.float().contiguous())
        self.diffuse = None
        self.register_buffer("albedo", None)
        if shader.diffuse is not None:
            self.diffuse = LobeGraph(shader.diffuse.axis, shader.diffuse.coefficients, shader.diffuse.exact)
            self.albedo = shader.diffuse.albedo.T.float().contiguous()

    def forward(self, light: Tensor, rotation: Tensor, eye: Tensor, pose: Tensor) -> Tensor:
        light = self.source.receive(light, rotation)
        frames = self.pose(pose)
        turned, points = frames, pose.T if pose.ndim == 2 else None
        if self.glossy is not None:
            turned = turned.index_select(-1, self.glossy)
            points = None if points is None else points.index_select(-1, self.glossy)
        values = self.exits(self.eye(eye, points, turned))
        weighted = [row(light, turned) * value for row, value in zip(self.rows, values.split(1, 1), strict=True)]
        radiance = weighted[0]
        for more in weighted[1:]:
            radiance = radiance + more
        radiance = self.spread(radiance * self.specular)
        if self.diffuse is not None and self.albedo is not None:
            radiance = radiance + self.diffuse(light, frames) * self.albedo
        return radiance.mT


class PosedEyeGraph(nn.Module):
    """Local directions `[3, B, G]` toward `eye [B, 3]` from `points [3, G]`, or along it, in frames `[3, 3, G]`.

    What `EyeGraph` computes for surfaces that stay.
    """

    local: Tensor

    def __init__(self, local: Tensor, eye: Eye) -> None:
        """`local [3, 3, G]`: rows tangent, bitangent, normal in the rest pose."""
        super().__init__()
        self.register_buffer("local", local.float().contiguous())
        self.point = eye == "point"

    def forward(self, eye: Tensor, points: Tensor | None, frames: Tensor) -> Tensor:
        if self.point and points is not None:
            away = scaled(eye.unsqueeze(-1) - points, 1, NOTHING)
        else:
            away = scaled(eye, -1, 0.0).unsqueeze(-1)
        # The transpose turns back into the rest pose.
        rest = (frames * away.unsqueeze(2)).sum(1)
        return above_horizon(*((rest * axis).sum(1) for axis in self.local.unbind(0)))
