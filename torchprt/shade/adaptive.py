"""Shading that adds high orders of the light only where they make a difference."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.sh.shapes import broadcast_shapes
from torchprt.shade.adaptive_layer import AdaptiveLayer, Region
from torchprt.shade.levels import check_orders, default_orders
from torchprt.shade.regions import Gate, Neighbours, check_faces
from torchprt.shade.shader import Shader, turned_light
from torchprt.shade.white import white

AGAINST = ("last", "base")


@dataclass(frozen=True)
class Regions:
    """Where the last frame went to which order: `layers`, a `Region` for every layer that is shaded adaptively.

    Belongs to one `AdaptiveShader` and one batch of lights, eyes and poses.
    """

    layers: Mapping[str, Region] = field(default_factory=dict)

    @property
    def orders(self) -> dict[str, Int[Tensor, "G"]]:
        """By layer the highest order at which each of its receivers was evaluated."""
        return {name: region.orders for name, region in self.layers.items()}


class Adapted(NamedTuple):
    """Radiance `[*B, V, 3]`, linear, and the regions, to be given to the call for the next frame."""

    radiance: Tensor
    regions: Regions


class AdaptiveShader(nn.Module):
    """Exit radiance as of `shader`, but for what higher orders of the light hardly change.

    Layers are shaded at order 3 and at the next of `levels` everywhere, and at the further ones only for receivers for
    which the last one made a difference of displayed radiance above a threshold, and around them. Nothing new is
    stored; layers and signals are those of the shader, and gradients flow to their parameters, the light and the eye.

    - `faces [F, 3]`, of the transfer: along their edges a region grows by breadth-first search where a higher order
      makes a difference that a lower one did not foretell, and fades out over `rings` of receivers. Without faces
      neither happens.
    - `diffuse`, `specular`: thresholds of the layers that do not and that do depend on the eye, in units of white:
      `shade.white(light)`, the radiance of a white surface that faces the light, with which pictures are exposed. So a
      brighter light changes nothing. None shades the layer whole, which for dense transfer vectors, where a receiver is
      a few multiplications, is faster (docs/adaptive.md); 0 goes to the last order everywhere, which is what `shader`
      does, to rounding; infinity stays at the first of `levels`.
    - `levels`: the orders, from the one that is everywhere to that of the shader; 3, 5, 7 and so on if omitted.
    - `against`: the difference is that from the order below ("last"), or from the first order ("base").
    - `hysteresis`: a receiver that is in leaves at this part of the threshold. It takes effect where `regions` of the
      last frame are given. `blend`: over what part of the threshold, above and below it, the next order fades in.

    `regions`: a call takes those of the last frame, of the same batch, and gives new ones. Without them nothing
    depends on what was shaded before.

    Laws: scaling the light scales radiance. Adding lights adds radiance to within the thresholds. A light in a batch
    gets what it gets alone, but for regions that grew together: work is done for the union of all regions. Radiance is
    continuous in light and eye if `blend` is above zero, but for where growing ends.
    Dynamic: which receivers are evaluated depends on values, so the module cannot be compiled or exported as a graph;
    `fixed_orders` can.

    `shader` is a submodule, whose parameters and buffers are the only ones. `adaptive`: by name the layers that are
    shaded adaptively.

    Raises InputError if a threshold is negative or NaN, `levels` do not rise to the order of the shader, `hysteresis`
    or `blend` is outside [0, 1], `rings` is negative, faces are of another mesh, or a layer cannot be taken apart.
    Source: the paper on locally adaptive products of spherical harmonics (WSCG 2013), sections 4.1 to 4.4. New here
    are `against` "last", hysteresis and blend, and rules of quadrature that grow with the order.
    """

    faces: Tensor | None

    def __init__(
        self,
        shader: Shader,
        faces: Tensor | None = None,
        *,
        diffuse: float | int | None = None,
        specular: float | int | None = 0.02,
        levels: Sequence[int] | None = None,
        against: str = "last",
        hysteresis: float | int = 0.5,
        blend: float | int = 0.1,
        rings: int = 2,
        grow: bool = True,
    ):
        super().__init__()
        for name, threshold in (("diffuse", diffuse), ("specular", specular)):
            if threshold is not None and not threshold >= 0:
                raise InputError(f"{name} is {threshold}: a threshold is a part of white, zero or more, or None")
        for name, part in (("hysteresis", hysteresis), ("blend", blend)):
            if not 0 <= part <= 1:
                raise InputError(f"{name} is {part}: give a number from 0 to 1")
        if against not in AGAINST:
            raise InputError(f"against '{against}' is unknown: use 'last' or 'base'")
        if rings < 0:
            raise InputError(f"rings is {rings}: give zero or more")
        if faces is not None:
            check_faces(faces, shader.vertices)
        self.shader, self.needs, self.order = shader, shader.needs, shader.order
        self.orders = check_orders(default_orders(shader.order) if levels is None else levels, shader.order)
        self.thresholds = {"diffuse": diffuse, "specular": specular}
        self.against, self.hysteresis, self.blend = against, float(hysteresis), float(blend)
        self.rings, self.grow = rings, grow
        self.register_buffer("faces", None if faces is None else faces.detach(), persistent=False)
        self.adaptive = self._made()

    def _made(self) -> dict[str, AdaptiveLayer]:
        """The layers that are shaded adaptively, with tables on the device and in the dtype of the shader."""
        made: dict[str, AdaptiveLayer] = {}
        for name, layer in self.shader.layers.items():
            threshold = self.thresholds["specular" if "eye" in layer.needs else "diffuse"]
            if threshold is None:
                continue
            gate = Gate(float(threshold), float(threshold) * self.hysteresis, self.blend)
            beside = None
            if self.faces is not None and len(self.faces):
                beside = Neighbours(self.faces.to(layer.weight.device), self.shader.vertices, layer.receivers)
            made[name] = AdaptiveLayer(
                layer, self.orders, gate, beside, against=self.against, rings=self.rings, grow=self.grow
            )
        return made

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> AdaptiveShader:
        super()._apply(fn, recurse)
        self.adaptive = self._made()
        return self

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
        frames: Float[Tensor, "*#B V 3 3"] | None = None,
        positions: Float[Tensor, "*#B V 3"] | None = None,
        regions: Regions | None = None,
    ) -> Adapted:
        """Linear exit radiance of every receiver, and the regions. Arguments are those of `Shader`.

        Raises InputError as `Shader`, if `regions` are of another batch or shader, and in a graph that is traced.
        """
        if torch.compiler.is_compiling():
            raise InputError("adaptive shading cannot be traced into a graph: fix the orders, with shade.fixed_orders")
        shader = self.shader
        shader.check_given(eye, view, frames, positions)
        wanted, bright = light.dtype, white(light.to(shader.turn.project.dtype))
        light = turned_light(light, rotation, shader.turn).to(shader.dtype)
        turned = None if frames is None and positions is None else shader.pose(frames, positions)
        radiance: Tensor | None = None
        made: dict[str, Region] = {}
        for name, layer in shader.layers.items():
            posed = None if turned is None else layer.among(turned, -3)
            values = layer.values(eye, view, posed, positions)
            adaptive = self.adaptive.get(name)
            if adaptive is None:
                sent = layer(light, values, posed)
            else:
                before = None if regions is None else regions.layers.get(name)
                _check_regions(before, adaptive, regions is not None, light, values, posed)
                sent, made[name] = adaptive(light, values, posed, bright.to(shader.dtype), before)
            radiance = layer.spread(sent.to(layer.weight.dtype), radiance, shader.vertices)
        assert radiance is not None
        return Adapted(radiance.mT.to(wanted), Regions(made))


def adaptive(shader: Shader, faces: Tensor | None = None, **options: object) -> AdaptiveShader:
    """`AdaptiveShader`, as it is made of a shader; see there."""
    return AdaptiveShader(shader, faces, **options)  # type: ignore[arg-type]


def _check_regions(
    before: Region | None, layer: AdaptiveLayer, given: bool, light: Tensor, values: Tensor | None, posed: Tensor | None
) -> None:
    if not given:
        return
    batches = [light.shape[:-2], () if values is None else values.shape[:-2], () if posed is None else posed.shape[:-3]]
    batch = broadcast_shapes(*batches)
    wanted = (*batch, layer.layer.signal.shape[0])
    if before is None or len(before.orders) != wanted[-1] or any(w.shape != wanted for w in before.weights):
        raise InputError("regions are of another shader or batch: give those of the call before this one, or none")
