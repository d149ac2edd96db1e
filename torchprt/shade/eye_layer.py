"""Layers that depend on the eye, whose rows are weighted with exit functions or with the factors of a BRDF."""

from __future__ import annotations

import abc
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import sample_hemisphere_map
from torchprt.sh import exit_functions
from torchprt.sh.precision import at_least_single
from torchprt.shade.dense import DenseSignal
from torchprt.shade.layer import LayerModule, M, layer_module
from torchprt.shade.signal import Making, hold
from torchprt.shade.view_directions import local_frames, local_views, toward_eye
from torchprt.transfer import Exit, Factored
from torchprt.transfer.layer import EyeLayer


class EyeLayerModule(LayerModule):
    """What the layers that depend on the eye share. Subclasses say what the functions e_i are (`exit_values`).

    Buffers: `specular`, those of the subclass and of the signal, and where the receivers are: `points [3, G]`, in the
    dtype of the positions if that is wider, and `frames [3, 3, G]`, rows tangent, bitangent, normal, at rest; both are
    float32 at least, and so are directions and tables.

    Laws: an eye below the tangent plane of a receiver counts as on it, an eye at a receiver as above it
    (`local_views`); a receiver whose normal is zero has no such layer. Directions are computed from eye - position in
    the dtype of the wider: in float32 they err by about 6e-8 (|eye| + |position|) / distance, so scenes far from the
    origin want positions and eye in float64; nothing but the subtraction is then done in it.
    """

    learnable: ClassVar[tuple[str, ...]] = ("specular",)
    per_receiver: ClassVar[tuple[str, ...]] = ("points", "frames")
    single: ClassVar[tuple[str, ...]] = ("points", "frames")
    specular: Tensor
    points: Tensor
    frames: Tensor

    def __init__(self, layer: EyeLayer, making: Making):
        receivers, dtype = making.receivers, at_least_single(making.dtype)
        index = layer.index(receivers.count)
        frames, has_frame = local_frames(receivers.normals[index], layer.tangents)
        lost = None if bool(has_frame.all()) else (~has_frame).nonzero()[:, 0]
        super().__init__(layer, making, lost)
        points = receivers.positions[index]
        self.register_buffer("points", points.T.to(torch.promote_types(points.dtype, dtype)).contiguous())
        self.register_buffer("frames", frames.permute(1, 2, 0).to(dtype).contiguous())

    @abc.abstractmethod
    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """The functions e_i of the local unit directions toward the eye."""

    def values(
        self, eye: Tensor | None, view: Tensor | None, frames: Tensor | None = None, positions: Tensor | None = None
    ) -> Float[Tensor, "*B G M"]:
        points = self.points
        if positions is not None and eye is not None:
            points = self.among(positions, -2).movedim(-1, 0)
            points = points.to(torch.promote_types(points.dtype, self.points.dtype))
        toward = toward_eye(points, eye, view).to(self.frames.dtype)
        if frames is not None:
            turn = frames.movedim((-2, -1), (0, 1))
            batch = max(turn.ndim - 2, toward.ndim - 1)
            turn = turn.reshape(3, 3, *(1,) * (batch - turn.ndim + 2), *turn.shape[2:])
            toward = toward.reshape(3, *(1,) * (batch - toward.ndim + 1), *toward.shape[1:])
            # The transpose turns back into the rest pose.
            toward = (turn * toward.unsqueeze(1)).sum(0)
        return self.exit_values(local_views(toward, self.frames)).to(self.specular.dtype)

    def posed(self: M, frames: Tensor | None, positions: Tensor | None) -> M:
        assert isinstance(self, EyeLayerModule)
        receivers, _, rows, _ = self.signal.shape
        single = torch.eye(rows, dtype=self.specular.dtype, device=self.frames.device)
        vectors = [self.toward(row.expand(receivers, rows), frames) for row in single.unbind(0)]
        matrix = torch.stack(vectors).permute(1, 3, 0, 2).to(self.specular.dtype).contiguous()
        turned = self.frames
        if frames is not None:
            lanes = frames.permute(1, 2, 0)
            turned = torch.stack([(lanes * axis).sum(1) for axis in self.frames.unbind(0)])
        points = self.points
        if positions is not None:
            points = self.among(positions, -2).T.to(points.dtype).contiguous()
        return self.changed(signal=DenseSignal.holding(matrix), frames=turned, points=points)


@layer_module.register(Exit)
class ExitLayer(EyeLayerModule):
    """Exit radiance in `sh.exit_functions`.

    `learn` may name "specular" and what the signal has.
    Source: Sloan, Hall, Hart and Snyder 2003, section 3, equation 1.
    """

    def __init__(self, layer: Exit, making: Making):
        super().__init__(layer, making)
        self.exit_order = layer.output_order
        self.projection = layer.projection

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        return exit_functions(local, self.exit_order, self.projection)


@layer_module.register(Factored)
class FactoredLayer(EyeLayerModule):
    """Exit radiance in the factors of a BRDF, read from their table.

    `views`, one of the choices of `shader`: called with local unit directions `[*B, G, 3]` instead of reading the
    table, to give `[*B, G, M]`. `learn` may name "factors", "specular" and what the signal has.
    Source: Sloan, Luna and Snyder 2005, section 5.
    """

    learnable = ("factors", "specular")
    choices = ("views",)
    single = (*EyeLayerModule.single, "factors")
    factors: Tensor

    def __init__(self, layer: Factored, making: Making):
        super().__init__(layer, making)
        hold(self, "factors", layer.factors, making)
        self.views = making.choices.get("views")
        self.exit_order = layer.factors.shape[-1]

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        return sample_hemisphere_map(self.factors, local) if self.views is None else self.views(local)
