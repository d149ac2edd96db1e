"""Clustered signals in a graph: batched products over blocks of receivers."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from torchprt.onnx.signal import SignalGraph, arranged, by_channel, signal_graph
from torchprt.shade import ClusteredSignal, SignalModule

# Receivers of one cluster that one product takes: padding against the overhead of a product.
BLOCK = 64
# PCA vectors that a product takes: clusters with about as many go together.
_STEPS = (0, 1, 2, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)


class BlockSignal(ClusteredSignal):
    """A `ClusteredSignal` whose receivers are in blocks of one cluster, each block one product of a batch.

    A Gather of rows is ten times slower in ONNX Runtime, and `embedding_bag` becomes a loop over receivers. The last
    block of a cluster is filled with its first receiver. `order [G']` says which one stands at every place.
    """

    order: Tensor

    def __init__(self, signal: ClusteredSignal) -> None:
        SignalModule.__init__(self, signal.shape)
        self.register_buffer("representatives", signal.representatives.detach())
        self.register_buffer("shared", signal.shared)
        bounds = torch.cat([signal.starts.long(), torch.tensor([len(signal.rows)])])
        # Of every receiver its mean comes first, then the PCA vectors of its cluster.
        label, counts = signal.rows[signal.starts.long()].long(), bounds.diff() - 1
        clusters = [(label == k).nonzero()[:, 0] for k in label.unique().tolist()]
        blocks: list[Tensor] = []
        for low, high in zip((-1, *_STEPS), (*_STEPS, int(counts.max()) + 1), strict=True):
            chosen = [members for members in clusters if low < int(counts[members[0]]) <= high]
            rows, weights = [], []
            width = 1 + max((int(counts[members[0]]) for members in chosen), default=0)
            for members in chosen:
                for some in members.split(BLOCK):
                    some = torch.cat([some, some[:1].expand(BLOCK - len(some))])
                    real = torch.arange(width) < counts[members[0]] + 1
                    place = torch.where(real, bounds[some, None] + torch.arange(width), bounds[some, None])
                    rows.append(signal.rows[place[0]].long())
                    weights.append(torch.where(real, signal.weights[place], 0).T)
                    blocks.append(some)
            if rows:
                number = len([name for name, _ in self.named_buffers() if name.startswith("rows")])
                self.register_buffer(f"rows{number}", torch.stack(rows))
                self.register_buffer(f"weights{number}", torch.stack(weights).contiguous())
        self.register_buffer("order", torch.cat(blocks), persistent=False)

    def blocks(self, table: Tensor) -> Tensor:
        """The blend of `table [R, D]` as blocks `[G' / BLOCK, D, BLOCK]`."""
        found, number = [], 0
        while hasattr(self, f"rows{number}"):
            rows, weights = getattr(self, f"rows{number}"), getattr(self, f"weights{number}")
            picked = table.index_select(0, rows.flatten()).unflatten(0, rows.shape)
            found.append(picked.mT @ weights)
            number += 1
        return found[0] if number == 1 else torch.cat(found)

    def blend(self, table: Tensor) -> Tensor:
        return self.blocks(table).mT.flatten(0, 1)


@arranged.register(ClusteredSignal)
def _in_blocks(signal: ClusteredSignal) -> tuple[BlockSignal, Tensor]:
    made = BlockSignal(signal)
    return made, made.order


@signal_graph.register(BlockSignal)
class BlockGraph(SignalGraph):
    """Clustered transfer: a light is applied to the representatives, blocks of receivers weigh what they send."""

    def table(self, light: Tensor) -> Tensor:
        """What the representatives send under `light [B, N, 3]`: `[R, B 3 M]`."""

        def product(signal: Tensor) -> Tensor:
            total, channels, rows, count = signal.shape
            if rows == 1 and channels == 1:
                return signal[:, 0, 0] @ light.mT.reshape(-1, count).mT
            if rows == 1:
                sent = signal[:, :, 0].transpose(0, 1) @ by_channel(light).mT
                return sent.permute(1, 2, 0).reshape(total, -1)
            flat = signal.transpose(0, 1).reshape(channels, total * rows, count).mT
            if channels == 1:
                found = (light.mT.reshape(-1, count) @ flat[0]).reshape(-1, total, rows)
            else:
                found = (by_channel(light) @ flat).transpose(0, 1).reshape(-1, total, rows)
            return found.transpose(0, 1).flatten(1)

        sent: Tensor = self.signal.sent(product)
        return sent

    def forward(self, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Tensor:
        return self.seen(self.table(light), values)

    def seen(self, table: Tensor, values: Tensor | None) -> Tensor:
        """Radiance of what the representatives send, in the directions of `values`."""
        if values is None:
            radiance = self.signal.blocks(table).transpose(0, 1).flatten(1)
            return self.weighed(radiance.reshape(-1, 3, radiance.shape[1]))
        rows = values.shape[1]
        blocks = self.signal.blocks(table).reshape(-1, values.shape[0], 3, rows, BLOCK)
        eyes = values.reshape(values.shape[0], rows, -1, BLOCK).permute(2, 0, 1, 3).unsqueeze(2)
        return self.weighed((blocks * eyes).sum(3).permute(1, 2, 0, 3).flatten(2))

    def fixed(self, light: Tensor) -> nn.Module:
        return FixedTable(self, light)


class FixedTable(nn.Module):
    """A `BlockGraph` under one light that is inside: values `[B, M, G']` to radiance `[B, 3, G']`."""

    table: Tensor

    def __init__(self, graph: BlockGraph, light: Tensor) -> None:
        super().__init__()
        table = graph.table(light.to(graph.signal.representatives.dtype).unsqueeze(0))
        self.register_buffer("table", table.detach().float())
        self.graph = graph.float()

    def forward(self, values: Tensor) -> Tensor:
        batch = values.shape[0]
        return self.graph.seen(self.table.unsqueeze(1).expand(-1, batch, -1).flatten(1), values)
