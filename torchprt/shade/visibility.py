"""Exit radiance from visibility alone: light, visibility and reflectance meet at directions of the hemisphere."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import Rotation, basis, exit_functions, gauss_legendre_hemisphere, hemisphere_basis, rotate
from torchprt.sh.basis import only_values_are_wanted
from torchprt.sh.euler import turn_by_euler
from torchprt.sh.precision import without_autocast
from torchprt.sh.shapes import broadcast_shapes
from torchprt.sh.turned_product import TurnedProduct, euler_turns
from torchprt.shade.batches import light_product, receivers_of
from torchprt.shade.eye_layer import EyeLayerModule
from torchprt.shade.layer import layer_module
from torchprt.shade.product_levels import ProductLevels, Rule, local_products
from torchprt.shade.signal import Making, SignalModule, hold
from torchprt.transfer import Visibility

V = TypeVar("V", bound="VisibilityLayer")


@layer_module.register(Visibility)
class VisibilityLayer(EyeLayerModule):
    """Exit radiance of visibility, its matrices made and used on the fly.

    The view is contracted first: at the D nodes of the rule, `sum_i e_i(v) kernel_id` times visibility, projected on
    the SH of the local frame and turned to the world, is the transfer vector of that view. It takes about 2 G D numbers
    of memory for each eye (D = 91 at degree 12) and, to fix a light, 6 G D for each light.
    Exit functions are those of `ExitLayer`. `learn` may name "kernel", "specular" and what the signal has.
    Source: Sloan, Kautz and Snyder 2002, section 4.2.
    """

    learnable = ("kernel", "specular")
    kernel: Tensor
    functions: Tensor
    harmonics: Tensor

    def __init__(self, layer: Visibility, making: Making):
        super().__init__(layer, making)
        hold(self, "kernel", layer.kernel, making)
        self.exit_order = layer.output_order
        self.projection = layer.projection
        self.degree = layer.degree
        self.turn = Rotation(layer.order, making.dtype).to(layer.kernel.device)
        nodes, _ = gauss_legendre_hemisphere(layer.degree)
        tables = {"functions": hemisphere_basis(nodes, layer.visibility_order), "harmonics": basis(nodes, layer.order)}
        for name, table in tables.items():
            self.register_buffer(name, table.to(self.kernel).contiguous(), persistent=False)

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """The exit functions of the local unit directions toward the eye."""
        return exit_functions(local, self.exit_order, self.projection)

    def toward(self, values: Tensor | None, frames: Tensor | None = None) -> Float[Tensor, "C N ..."]:
        assert values is not None
        return self.vectors(values).movedim(-2, 0).unsqueeze(0)

    def vectors(self, values: Float[Tensor, "*B G M"]) -> Float[Tensor, "*B N G"]:
        """Transfer vectors toward eyes, the eyes first."""
        return torch.cat(list(self.in_pieces(values, self.signal, self.frames, self.rule())), -1)

    def rule(self) -> Rule:
        """Where all of its visibility meets all of the light."""
        return Rule(self.kernel, self.functions, self.harmonics)

    def in_pieces(
        self, values: Float[Tensor, "*B g M"], signal: SignalModule, frames: Float[Tensor, "3 3 g"], rule: Rule
    ) -> Iterator[Float[Tensor, "*B N p"]]:
        """Transfer vectors of some receivers, piece after piece. `values`, `signal` and `frames` of those receivers."""
        pieces = local_products(values.mT, signal, rule)
        start = 0
        for local in pieces:
            turn = frames[..., start : start + local.shape[-1]].permute(2, 1, 0)
            start += local.shape[-1]
            yield self._turned(local.mT.unsqueeze(-1), turn)[..., 0].mT

    def under(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        local = self._turned(light.unsqueeze(-3), self.frames.permute(2, 0, 1))
        arriving = (local.mT @ self.harmonics.mT) * self.seen().unsqueeze(-2)
        return (arriving @ self.kernel.mT).movedim(-3, -1).contiguous()

    def sent(
        self, light: Tensor, values: Tensor | None, frames: Tensor | None, out: Tensor | None
    ) -> Float[Tensor, "... 3 G"]:
        if out is not None or torch.compiler.is_compiling():
            return light_product(light, self.toward(values), out=out)
        assert values is not None
        return self.products(light, values, self.rule(), None)(None)

    def products(
        self, light: Float[Tensor, "*#B N 3"], values: Float[Tensor, "*#B G M"], rule: Rule, turns: Tensor | None
    ) -> Callable[[Tensor | None], Tensor]:
        """From some receivers, or None for all, to their radiance `[*B, 3, g]` by a rule, without the weight.

        `turns` as of `sh.euler_turns`, made here if not given.
        """
        seen = math.isqrt(rule.functions.shape[1])
        if math.prod(values.shape[:-2]) != 1 or not only_values_are_wanted(light, values, rule.kernel, self.frames):

            def by_vectors(receivers: Tensor | None) -> Tensor:
                some, frames = values, self.frames
                if receivers is not None:
                    some, frames = receivers_of(some.mT, receivers).mT, receivers_of(frames, receivers)
                vectors = self.in_pieces(some, self._among(seen, receivers), frames, rule)
                return torch.cat([light_product(light, piece.movedim(-2, 0).unsqueeze(0)) for piece in vectors], -1)

            return by_vectors
        wide, batch = self.frames.dtype, broadcast_shapes(light.shape[:-2], values.shape[:-2])
        product = without_autocast(TurnedProduct(light.to(wide)).__call__)
        rows = values.reshape(values.shape[-2:]).mT
        turned = euler_turns(self.frames.transpose(0, 1)) if turns is None else turns

        def by_turns(receivers: Tensor | None) -> Tensor:
            some, about = rows, turned
            if receivers is not None:
                some, about = receivers_of(some, receivers), receivers_of(about, receivers)
            local = local_products(some, self._among(seen, receivers), rule)
            sizes, found = 0, []
            for piece in local:
                found.append(product(piece.to(wide), about[:, sizes : sizes + piece.shape[-1]]))
                sizes += piece.shape[-1]
            radiance = torch.cat(found, -1).to(light.dtype)
            return radiance.reshape(*batch, *radiance.shape[-2:])

        return by_turns

    def _among(self, order: int, receivers: Tensor | None) -> SignalModule:
        """The first bands of visibility of some receivers."""
        whole = receivers is None and order * order == self.signal.shape[3]
        return self.signal if whole else self.signal.part(0, order, receivers)

    def at_order(self: V, order: int, index: Tensor) -> V:
        rule = ProductLevels(self, (order,)).rule(0)
        made = self.taken(index, self.signal.part(0, math.isqrt(rule.functions.shape[1]), index))
        made = made.changed(kernel=rule.kernel, functions=rule.functions, harmonics=rule.harmonics)
        made.turn = Rotation(order, self.frames.dtype).to(self.frames.device)
        made.bands = order
        return made

    def levels(self, orders: Sequence[int]) -> ProductLevels:
        return ProductLevels(self, orders)

    def seen(self) -> Float[Tensor, "G D"]:
        """Visibility at the nodes."""
        return self.signal.applied(self.functions.mT)

    def _turned(self, light: Tensor, rotation: Tensor) -> Tensor:
        if torch.compiler.is_compiling():
            return self.turn(light, rotation)
        if only_values_are_wanted(light, rotation):
            # Half of the time of `rotate` is its check, and these frames were checked when the layer was made.
            return without_autocast(turn_by_euler)(light.to(rotation.dtype), rotation).to(light.dtype)
        return rotate(light, rotation)
