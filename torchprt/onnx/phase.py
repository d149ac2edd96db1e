"""The layer of a volume that scatters in one direction more than in another, in a graph."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torchprt.onnx.layers import LayerGraph, layer_graph
from torchprt.onnx.toward_eye import NOTHING, Eye, scaled
from torchprt.sh import basis
from torchprt.shade import LayerModule, PhaseLayer


class PhaseGraph(LayerGraph):
    """What `shade.PhaseLayer` computes, without ReduceMax, which graphs lack."""

    points: Tensor
    shares: Tensor
    mean: Tensor

    def prepare(self, layer: LayerModule, eye: Eye, posed: bool) -> None:
        assert isinstance(layer, PhaseLayer)
        self.point, self.order = eye == "point", layer.exit_order
        self.register_buffer("points", layer.points.float().contiguous())
        self.register_buffer("shares", layer.shares.float().unsqueeze(-1))
        mean = torch.zeros(self.order**2, 1)
        mean[0] = 1 / math.sqrt(4 * math.pi)
        self.register_buffer("mean", mean)

    def values(self, eye: Tensor | None, frames: Tensor | None, points: Tensor | None) -> Tensor:
        assert eye is not None
        if self.point:
            away = scaled(eye.unsqueeze(-1) - self.points, 1, NOTHING)
        else:
            away = scaled(eye, -1, 0.0).unsqueeze(-1) + 0 * self.points
        squared = away * away
        total = (squared[:, 0] + squared[:, 1] + squared[:, 2]).unsqueeze(1)
        found = total > NOTHING
        away = torch.where(found, away / torch.sqrt(torch.where(found, total, 1.0)), 1.0)
        seen = basis(-away.transpose(1, 2), self.order).transpose(1, 2) * self.shares
        return torch.where(found, seen, self.mean)


layer_graph.register(PhaseLayer, PhaseGraph)
