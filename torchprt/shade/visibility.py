"""Exit radiance from visibility alone: light, visibility and reflectance meet at directions of the hemisphere."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import Rotation, basis, exit_functions, gauss_legendre_hemisphere, hemisphere_basis, rotate
from torchprt.shade.batches import light_product
from torchprt.shade.eye_layer import EyeLayerModule
from torchprt.shade.layer import layer_module
from torchprt.shade.signal import Making, hold
from torchprt.transfer import Visibility


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
        local = ((values @ self.kernel) * self.seen()) @ self.harmonics
        world = self._turned(local.unsqueeze(-1), self.frames.permute(2, 1, 0))
        return world.movedim(-1, 0).mT[0]

    def under(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        local = self._turned(light.unsqueeze(-3), self.frames.permute(2, 0, 1))
        arriving = (local.mT @ self.harmonics.mT) * self.seen().unsqueeze(-2)
        return (arriving @ self.kernel.mT).movedim(-3, -1).contiguous()

    def sent(
        self, light: Tensor, values: Tensor | None, frames: Tensor | None, out: Tensor | None
    ) -> Float[Tensor, "... 3 G"]:
        return light_product(light, self.toward(values), out=out)

    def seen(self) -> Float[Tensor, "G D"]:
        """Visibility at the nodes."""
        return self.signal.applied(self.functions.mT)

    def _turned(self, light: Tensor, rotation: Tensor) -> Tensor:
        return self.turn(light, rotation) if torch.compiler.is_compiling() else rotate(light, rotation)
