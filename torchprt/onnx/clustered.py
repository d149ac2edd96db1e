"""The modules that are traced into ONNX for clustered transfer: batched products over blocks of receivers."""

from __future__ import annotations

import copy
from typing import TypeVar

import torch
from torch import Tensor, nn

from torchprt.onnx.graph import Source, make_graph
from torchprt.shade import ClusteredShader, ViewShader
from torchprt.shade.clustered import Blend, ClusteredMatrix
from torchprt.transfer import ClusteredTransfer, CompressedTransfer, DiffuseTransfer

# Receivers of one cluster that one product takes: padding against the overhead of a product.
BLOCK = 64
# PCA vectors that a product takes: clusters with about as many go together.
_STEPS = (0, 1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)


class BlockBlend(Blend):
    """A `Blend` whose receivers are in blocks of one cluster, each block one product of a batch.

    A Gather of rows is ten times slower in ONNX Runtime, and `embedding_bag` becomes a loop over receivers. The last
    block of a cluster is filled with its first receiver. `receivers [V']` says which one stands at every place.
    """

    receivers: Tensor

    def __init__(self, blend: Blend, transfer: CompressedTransfer) -> None:
        nn.Module.__init__(self)
        self.register_buffer("representatives", blend.representatives.detach())
        self.register_buffer("shared", blend.shared)
        label, counts = transfer.label.long(), transfer.counts
        members = [(label == k).nonzero()[:, 0] for k in range(len(counts))]
        bounds = torch.cat([blend.starts.long(), torch.tensor([len(blend.rows)])])
        blocks: list[Tensor] = []
        for low, high in zip((-1, *_STEPS), (*_STEPS, int(counts.max()) + 1), strict=True):
            chosen = ((counts > low) & (counts <= high)).nonzero()[:, 0].tolist()
            rows, weights = [], []
            width = 1 + max((int(counts[k]) for k in chosen), default=0)
            for k in chosen:
                for some in members[k].split(BLOCK):
                    some = torch.cat([some, some[:1].expand(BLOCK - len(some))])
                    real = torch.arange(width) < counts[k] + 1
                    place = torch.where(real, bounds[some, None] + torch.arange(width), bounds[some, None])
                    rows.append(blend.rows[place[0]].long())
                    weights.append(torch.where(real, blend.weights[place], 0).T)
                    blocks.append(some)
            if rows:
                number = len([name for name, _ in self.named_buffers() if name.startswith("rows")])
                self.register_buffer(f"rows{number}", torch.stack(rows))
                self.register_buffer(f"weights{number}", torch.stack(weights).contiguous())
        self.register_buffer("receivers", torch.cat(blocks), persistent=False)

    def blocks(self, table: Tensor) -> Tensor:
        """The blend of `table [R, D]` as blocks `[V' / BLOCK, D, BLOCK]`."""
        found, number = [], 0
        columns = table.mT
        while hasattr(self, f"rows{number}"):
            rows, weights = getattr(self, f"rows{number}"), getattr(self, f"weights{number}")
            picked = columns.index_select(1, rows.flatten()).unflatten(1, rows.shape).transpose(0, 1)
            found.append(picked @ weights)
            number += 1
        return found[0] if number == 1 else torch.cat(found)

    def forward(self, table: Tensor) -> Tensor:
        return self.blocks(table).mT.flatten(0, 1)


class ClusteredGraph(nn.Module):
    """`light [B, N, 3]` or environment and `rotation [B, 3, 3]` to `radiance [B, V, 3]`, all float32."""

    albedo: Tensor
    place: Tensor

    def __init__(self, transfer: ClusteredTransfer, source: Source, size: int) -> None:
        super().__init__()
        self.light = make_graph(without_vertices(transfer), source, size)
        self.blend = BlockBlend(ClusteredShader(transfer, dtype=torch.float32).blend, transfer)
        self.register_buffer("place", _places(self.blend.receivers, transfer.vertices))
        self.register_buffer("albedo", transfer.albedo.detach().float().T.contiguous())

    def forward(self, light: Tensor, rotation: Tensor) -> Tensor:
        light = self.light.receive(light, rotation)

        def product(signal: Tensor) -> Tensor:
            channels, count = signal.shape[1:]
            if channels == 1:
                return signal[:, 0] @ light.mT.reshape(-1, count).mT
            return (signal.transpose(0, 1) @ light.permute(2, 1, 0)).permute(1, 2, 0).reshape(len(signal), -1)

        found = self.blend.blocks(self.blend.sent(product)).transpose(0, 1).flatten(1)
        return (found.index_select(1, self.place).reshape(-1, 3, len(self.place)) * self.albedo).mT


class ClusteredLayer(nn.Module):
    """Clustered exit matrices: `light [B, N, 3]`, turned, and exit values `[B, M, V']` to radiance `[B, 3, V']`."""

    specular: Tensor

    def __init__(self, shader: ClusteredMatrix) -> None:
        """`shader`: of `in_blocks`."""
        super().__init__()
        assert isinstance(shader.blend, BlockBlend)
        self.blend = shader.blend
        self.register_buffer("specular", shader.specular.T.float().contiguous())

    def table(self, light: Tensor) -> Tensor:
        """Exit coefficients `[R, B 3 M]` of the representatives."""

        def product(signal: Tensor) -> Tensor:
            total, channels, rows, count = signal.shape
            flat = signal.transpose(0, 1).reshape(channels, total * rows, count).mT
            if channels == 1:
                found = (light.mT.reshape(-1, count) @ flat[0]).reshape(-1, total, rows)
            else:
                found = (light.permute(2, 0, 1) @ flat).transpose(0, 1).reshape(-1, total, rows)
            return found.transpose(0, 1).flatten(1)

        return self.blend.sent(product)

    def forward(self, light: Tensor, values: Tensor) -> Tensor:
        return self.seen(self.table(light), values)

    def seen(self, table: Tensor, values: Tensor) -> Tensor:
        """Radiance of what the representatives send, in the directions of `values`."""
        rows = values.shape[1]
        blocks = self.blend.blocks(table).reshape(-1, values.shape[0], 3, rows, BLOCK)
        eyes = values.reshape(values.shape[0], rows, -1, BLOCK).permute(2, 0, 1, 3).unsqueeze(2)
        return (blocks * eyes).sum(3).permute(1, 2, 0, 3).flatten(2) * self.specular


class FixedTable(nn.Module):
    """A `ClusteredLayer` under one light that is inside: exit values `[B, M, V']` to radiance `[B, 3, V']`."""

    table: Tensor

    def __init__(self, layer: ClusteredLayer, light: Tensor) -> None:
        super().__init__()
        table = layer.table(light.to(layer.blend.representatives.dtype).unsqueeze(0))
        self.register_buffer("table", table.float())
        self.layer = layer.float()

    def forward(self, values: Tensor) -> Tensor:
        batch = values.shape[0]
        return self.layer.seen(self.table.unsqueeze(1).expand(-1, batch, -1).flatten(1), values)


S = TypeVar("S", bound=ViewShader)


def in_blocks(shader: S, transfer: CompressedTransfer) -> S:
    """`shader` with its receivers in the order of blocks, some of them more than once, and a `BlockBlend`."""
    sorted_ = copy.copy(shader)
    sorted_._buffers, sorted_._modules = dict(shader._buffers), dict(shader._modules)
    blend = BlockBlend(shader.blend, transfer)  # type: ignore[arg-type]
    sorted_.blend = blend
    order = blend.receivers
    sorted_.frames, sorted_.points = shader.frames[..., order], shader.points[..., order]
    sorted_.glossy = shader.glossy[order]
    if len(shader.specular) > 1:
        sorted_.specular = shader.specular[order]
    exponent = getattr(shader, "exponent", None)
    if exponent is not None and exponent.numel() > 1:
        sorted_.exponent = exponent[order]
    return sorted_


def without_vertices(transfer: ClusteredTransfer) -> DiffuseTransfer:
    """Transfer of the same order that only receives light."""
    return DiffuseTransfer(
        transfer=torch.zeros(1, transfer.order**2, 0),
        albedo=torch.ones(1, 1),
        positions=transfer.positions[:0],
        normals=transfer.normals[:0],
        faces=transfer.faces[:0],
    )


def _places(receivers: Tensor, vertices: int) -> Tensor:
    return torch.zeros(vertices, dtype=torch.int64).index_put((receivers,), torch.arange(len(receivers)))
