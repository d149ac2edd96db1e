"""Layers in a graph: their functions of the eye, their signal, and the receivers that they are about."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from torchprt.onnx.signal import SignalGraph, arranged, signal_graph
from torchprt.onnx.toward_eye import Eye, TowardEye
from torchprt.sh import basis
from torchprt.shade import EyeLayerModule, FactoredLayer, LayerModule, VisibilityLayer


class LayerGraph(nn.Module):
    """`light [B, N, 3]`, turned, to radiance `[B, 3, V]`, zero where the layer has no receiver.

    Other layers are registered with `layer_graph.register`, as classes made from the module of the layer, the number of
    vertices, what an eye is, whether there is a pose, and a light that is to be inside.
    """

    receivers: Tensor | None
    weight: Tensor | None
    # Lights of one entry of the batch, which share its eye.
    lights: int = 1

    def __init__(
        self, layer: LayerModule, vertices: int, eye: Eye, posed: bool = False, light: Tensor | None = None
    ) -> None:
        """`light [N, 3]`: the one that is to be inside, if there is one; `seen` gives radiance then."""
        super().__init__()
        signal, order = arranged(layer.signal)
        self.bands = layer.bands
        held = layer if order is None else layer.taken(order, signal)
        # Where a receiver stands at several places its weight is applied once, when it is back at its own.
        after = order is not None and layer.receivers is None
        product = self.product(held, None if after else held.weight)
        self.register_buffer("weight", layer.weight.detach().T.float().contiguous() if after else None)
        self.signal: nn.Module = product
        if light is not None:
            fixed = product.fixed(layer.lit(light))
            if fixed is None:
                held = layer
                fixed = FixedCoefficients(layer.under(layer.lit(light)) * layer.weight.T.unsqueeze(-2))
                self.weight = None
            self.signal, held = fixed, held.float()
        self.register_buffer("receivers", layer.receivers.int() if posed and layer.receivers is not None else None)
        self.spread = Spread(held.receivers, vertices)
        self.prepare(held, eye, posed)

    def prepare(self, layer: LayerModule, eye: Eye, posed: bool) -> None:
        """Makes what gives the functions of the eye."""

    def product(self, layer: LayerModule, weight: Tensor | None) -> SignalGraph:
        return signal_graph(layer.signal, weight)

    def values(self, eye: Tensor | None, frames: Tensor | None, points: Tensor | None) -> Tensor | None:
        """The functions of the eye, `[B, M, G]`."""
        return None

    def forward(
        self, light: Tensor, eye: Tensor | None, frames: Tensor | None = None, points: Tensor | None = None
    ) -> Tensor:
        if self.bands is not None:
            light = light[:, : self.bands**2]
        if self.receivers is not None:
            frames = None if frames is None else frames.index_select(-1, self.receivers)
            points = None if points is None else points.index_select(-1, self.receivers)
        values = self.values(eye, frames, points)
        if values is not None and self.lights > 1:
            assert isinstance(self.signal, SignalGraph)
            return self._weighted(self.signal.shared(light, values, frames, self.lights))
        return self._weighted(self.signal(light, values, frames))

    def seen(self, eye: Tensor) -> Tensor:
        """Radiance `[B, 3, V]` under the light that is inside."""
        return self._weighted(self.signal(self.values(eye, None, None)))

    def _weighted(self, radiance: Tensor) -> Tensor:
        spread: Tensor = self.spread(radiance)
        return spread if self.weight is None else spread * self.weight


class EyeLayerGraph(LayerGraph):
    """A layer that depends on the eye, in its exit functions."""

    def prepare(self, layer: LayerModule, eye: Eye, posed: bool) -> None:
        assert isinstance(layer, EyeLayerModule)
        self.toward = TowardEye(layer.frames, None if posed else layer.points, eye)
        self.exits = self.exit_functions(layer)

    def exit_functions(self, layer: EyeLayerModule) -> Callable[[Tensor], Tensor]:
        """From local directions `[3, B, G]` to values `[B, M, G]`."""
        # The layer is no submodule: of its tensors only those that the functions read belong to the graph.
        return lambda local: layer.exit_values(local.movedim(0, -1)).mT

    def values(self, eye: Tensor | None, frames: Tensor | None, points: Tensor | None) -> Tensor:
        assert eye is not None
        return self.exits(self.toward(eye, frames, points))


class FactoredGraph(EyeLayerGraph):
    """A layer in factors that are read from their table."""

    def exit_functions(self, layer: EyeLayerModule) -> Callable[[Tensor], Tensor]:
        assert isinstance(layer, FactoredLayer)
        return FactorGraph(layer.factors) if layer.views is None else super().exit_functions(layer)


class VisibilityGraph(EyeLayerGraph):
    """A layer of visibility, whose matrices exist nowhere: its transfer vectors toward an eye, and then the light."""

    def product(self, layer: LayerModule, weight: Tensor | None) -> SignalGraph:
        assert isinstance(layer, VisibilityLayer)
        return TowardGraph(layer, weight)


@functools.singledispatch
def layer_graph(
    layer: LayerModule, vertices: int, eye: Eye, posed: bool = False, light: Tensor | None = None
) -> LayerGraph:
    """The part of a graph for a layer, by the class of its module."""
    return LayerGraph(layer, vertices, eye, posed, light)


layer_graph.register(EyeLayerModule, EyeLayerGraph)
layer_graph.register(FactoredLayer, FactoredGraph)
layer_graph.register(VisibilityLayer, VisibilityGraph)


class FixedCoefficients(nn.Module):
    """Exit values `[B, M, G]` to radiance `[B, 3, G]` under one light that is inside."""

    coefficients: Tensor

    def __init__(self, coefficients: Tensor) -> None:
        super().__init__()
        self.register_buffer("coefficients", coefficients.detach().float().contiguous())

    def forward(self, values: Tensor) -> Tensor:
        return (self.coefficients * values.unsqueeze(1)).sum(2)


class TowardGraph(SignalGraph):
    """The transfer vectors of a layer toward an eye, then the light.

    The tables of the rule and, up to a megabyte, what only depends on them are constants of the graph; a runtime folds
    the rest when it opens the file.
    """

    def __init__(self, layer: VisibilityLayer, weight: Tensor | None) -> None:
        super().__init__(None, weight)
        # No submodule, as for the exit functions: of its tensors only those that are read belong to the graph.
        self.layer = [layer]

    def forward(self, light: Tensor, values: Tensor | None, frames: Tensor | None) -> Tensor:
        assert values is not None
        return self.weighed(light.mT @ self.vectors(values.permute(2, 0, 1)).permute(1, 2, 0))

    def shared(self, light: Tensor, values: Tensor, frames: Tensor | None, lights: int) -> Tensor:
        # The vectors are what costs: made once an eye, for all its lights.
        vectors = self.vectors(values.permute(2, 0, 1)).permute(1, 2, 0)
        rows = light.mT.reshape(-1, 3 * lights, light.shape[1]) @ vectors
        return self.weighed(rows.reshape(-1, 3, rows.shape[2]))

    def vectors(self, values: Tensor) -> Tensor:
        """Transfer vectors `[G, B, N]` of exit values `[G, B, M]`: what `VisibilityLayer.vectors` computes.

        Receivers first, so that the B eyes are rows of a product and no batch of it: ONNX Runtime does not broadcast a
        batch of none, and one product with all eyes is faster than one an eye.
        """
        layer = self.layer[0]
        receivers, turn = len(values), layer.turn

        def times(rows: Tensor, table: Tensor) -> Tensor:
            return (rows.reshape(-1, len(table)) @ table).reshape(receivers, -1, table.shape[1])

        local = times(times(values, layer.kernel) * layer.seen().unsqueeze(1), layer.harmonics)
        # `sh.Rotation` by the frames: even and odd bands are evaluated apart at turned points, and projected back.
        points = (layer.frames.permute(0, 2, 1) @ turn.points.mT).movedim(0, -1)
        parted = (local.unsqueeze(2) * turn.parity.mT).reshape(receivers, -1, local.shape[-1])
        return times(parted @ basis(points, turn.order).mT, turn.project)


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


class Spread(nn.Module):
    """Radiance `[B, 3, G]` of the glossy receivers to `[B, 3, V]`, zero elsewhere.

    Zeros are added behind the G and a Gather puts all in their places: a Scatter is a loop in some runtimes.
    """

    place: Tensor | None
    zero: Tensor

    def __init__(self, receivers: Tensor | None, vertices: int) -> None:
        """`receivers [G]`: which vertices they are, one perhaps more than once; None if each is its own."""
        super().__init__()
        place, self.missing = None, False
        if receivers is not None:
            count = len(receivers)
            place = torch.full((vertices,), count).index_put((receivers,), torch.arange(count))
            self.missing = bool((place == count).any())
            place = None if torch.equal(place, torch.arange(count)) else place
        self.register_buffer("place", place)
        self.register_buffer("zero", torch.zeros(1, 1, 1))

    def forward(self, radiance: Tensor) -> Tensor:
        if self.place is None:
            return radiance
        if self.missing:
            radiance = torch.cat([radiance, self.zero.expand(radiance.shape[0], 3, 1)], -1)
        return radiance.index_select(-1, self.place)
