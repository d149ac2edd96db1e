"""Signals in zonal lobes in a graph: their pose is an input."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

from torchprt.onnx.signal import SignalGraph, by_channel, fold, signal_graph
from torchprt.shade import ZonalSignal


@signal_graph.register(ZonalSignal)
class ZonalGraph(SignalGraph):
    """What each row sends under a light is made once for a pose, and every eye weighs the rows.

    The pose has no batch: the transfer vectors of a pose are made once for all lights, and poses share nothing that a
    batch would save. The weight is folded into the coefficients of a single row wherever that stores nothing more.
    """

    weight: Tensor | None

    def __init__(self, signal: ZonalSignal, weight: Tensor) -> None:
        nn.Module.__init__(self)
        _, rows, lobes, bands, _ = signal.coefficients.shape
        apart = signal.exact.shape[2]
        weights = torch.cat([signal.exact, signal.coefficients.flatten(2, 3)], 2)
        left: Tensor | None = weight.detach().T.float().contiguous()
        if rows == 1:
            folded, left = fold(weights[:, 0], weight)
            weights = folded.unsqueeze(1)
        exact, coefficients = weights.split([apart, lobes * bands], 2)
        coefficients = coefficients.unflatten(2, (lobes, bands))
        # The graph takes them as they are.
        axis = normalize(signal.axis.detach().double(), dim=2)
        parts = zip(axis, coefficients.unbind(1), exact.unbind(1), strict=True)
        self.rows = nn.ModuleList(LobeGraph(*part) for part in parts)
        self.register_buffer("weight", left)

    def forward(self, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Tensor:
        assert frames is not None
        sent = [row(light, frames) for row in self.rows]
        if values is not None:
            sent = [row * value for row, value in zip(sent, values.split(1, 1), strict=True)]
        radiance = sent[0]
        for more in sent[1:]:
            radiance = radiance + more
        return self.weighed(radiance)


class LobeGraph(nn.Module):
    """`light [B, N, 3]`, turned, and frames `[3, 3, V]` to radiance `[B, 3, V]`: what `lobe_vectors . light` computes.

    y_lm is its leading coefficient, which goes to the light, times a polynomial p_lm(z) that begins with z^(l - m),
    times the real or imaginary part of (x + i y)^m. A lobe's coefficient is applied to the polynomials, of which there
    are half as many; lobes are added up m by m. Nothing is concatenated before the last lobe. In ONNX Runtime it takes
    a third of the time of the operations that torch uses.
    """

    rows: Tensor
    scale: Tensor
    constant: Tensor
    linear: Tensor

    def __init__(self, axis: Tensor, coefficients: Tensor, exact: Tensor) -> None:
        """`axis [L, 3, V]`, `coefficients [C, L, Z, V]`, `exact [C, J, V]`."""
        super().__init__()
        self.first = 2 if exact.shape[1] else 0
        self.order = coefficients.shape[2] + self.first
        self.channels, self.lobes = coefficients.shape[:2]
        for lobe in range(self.lobes):
            self.register_buffer(f"axis{lobe}", axis[lobe].float().contiguous())
            for l in range(self.first, self.order):
                weight = coefficients[:, lobe, l - self.first].unsqueeze(1).float().contiguous()
                self.register_buffer(f"weight{lobe}_{l}", weight)
        if self.first:
            self.register_buffer("constant", exact[:, :1].float().contiguous())
            # y_1m are -y, z, -x: the signs go to the light.
            self.register_buffer("linear", exact[:, [3, 1, 2]].float() * torch.tensor([[-1.0], [-1.0], [1.0]]))
        rows, scale = ([0, 3, 1, 2], [1.0, -1.0, -1.0, 1.0]) if self.first else ([], [])
        for m in range(self.order if self.lobes else 0):
            for side in (m,) if m == 0 else (m, -m):
                for l in range(max(m, self.first), self.order):
                    rows.append(l * l + l + side)
                    scale.append(leading(l, m))
        self.register_buffer("rows", torch.tensor(rows))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float64).float())

    def forward(self, light: Tensor, frames: Tensor) -> Tensor:
        parts: list[Tensor] = []
        for lobe in range(self.lobes):
            more = self._lobe(lobe, frames)
            parts = [total + part for total, part in zip(parts, more, strict=True)] if lobe else more
        if self.first:
            turned = (frames * self.linear.unsqueeze(1)).sum(2)
            parts = [self.constant, turned, *parts]
        vectors = torch.cat(parts, 1)
        if self.channels == 3:
            return ((by_channel(light).index_select(-1, self.rows) * self.scale) @ vectors).movedim(0, 1)
        lights = light.mT.index_select(-1, self.rows) * self.scale
        count, vertices = vectors.shape[1:]
        return (lights.reshape(-1, count) @ vectors[0]).reshape(-1, 3, vertices)

    def _lobe(self, lobe: int, frames: Tensor) -> list[Tensor]:
        """Its vectors over the leading coefficients: `[C, bands, V]` for m = 0, then two for each m."""
        x, y, z = (frames * getattr(self, f"axis{lobe}")).sum(1).split(1)
        weights = [None] * self.first + [getattr(self, f"weight{lobe}_{l}") for l in range(self.first, self.order)]
        cosine, sine = x, y
        parts: list[Tensor] = []
        for m in range(self.order):
            if m > 1:
                cosine, sine = x * cosine - y * sine, x * sine + y * cosine
            polynomials: list[Tensor | float] = [1.0, z]
            for l in range(m + 2, self.order):
                before, last = polynomials[-2:]
                polynomials.append(z * last - before * ((l - 1) ** 2 - m * m) / (4 * (l - 1) ** 2 - 1))
            bands = range(max(m, self.first), self.order)
            if not bands:
                continue
            weighted = torch.cat([weights[l] * polynomials[l - m] for l in bands], 1)
            parts += [weighted] if m == 0 else [weighted * cosine, weighted * sine]
        return parts


def leading(l: int, m: int) -> float:
    """The coefficient of z^(l - m) {Re, Im} (x + i y)^m in y_lm, m >= 0."""
    value = math.sqrt(0.25 / math.pi) if m == 0 else -math.sqrt(0.75 / math.pi)
    for k in range(2, m + 1):
        value *= -math.sqrt((2 * k + 1) / (2 * k))
    for k in range(m + 1, l + 1):
        value *= math.sqrt((4 * k * k - 1) / (k * k - m * m))
    return value
