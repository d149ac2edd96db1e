"""Exit radiance from visibility alone: light, visibility and reflectance meet at directions of the hemisphere."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import Projection, basis, exit_functions, gauss_legendre_hemisphere, hemisphere_basis, rotate
from torchprt.shade.view import ViewShader, with_normals
from torchprt.transfer import VisibilityTransfer


class VisibilityShader(ViewShader):
    """Exit radiance of `VisibilityTransfer`, its matrices made and used on the fly.

    The view is contracted first: at the D nodes of the rule, `sum_i e_i(v) kernel_id` times visibility, projected on
    the SH of the local frame and turned to the world, is the transfer vector of that view. It takes about 2 G D numbers
    of memory for each eye (D = 91 at degree 12) and, to fix a light, 6 G D for each light.
    Exit functions are those of `GlossyShader`.
    Made by `torchprt.shader(transfer)`; `learn` may name "visibility", "kernel", "specular", "albedo", "diffuse".
    Source: Sloan, Kautz and Snyder 2002, section 4.2.
    """

    visibility: Tensor
    kernel: Tensor
    functions: Tensor
    harmonics: Tensor

    def __init__(self, transfer: VisibilityTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()):
        visibility = with_normals(transfer, transfer.visibility)
        super().__init__(transfer, dtype, learn, {"visibility": visibility, "kernel": transfer.kernel})
        self.tabulate(transfer.degree, transfer.visibility_order, transfer.output_order, transfer.projection)

    def tabulate(self, degree: int, visibility_order: int, output_order: int, projection: Projection) -> None:
        """The functions at the nodes of the rule."""
        self.output_order = output_order
        self.projection = projection
        nodes, _ = gauss_legendre_hemisphere(degree)
        tables = {"functions": hemisphere_basis(nodes, visibility_order), "harmonics": basis(nodes, self.order)}
        for name, table in tables.items():
            self.register_buffer(name, table.to(self.kernel).contiguous(), persistent=False)

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """The exit functions of the local unit directions toward the eye."""
        return exit_functions(local, self.output_order, self.projection)

    def vectors(self, values: Float[Tensor, "P G M"]) -> Float[Tensor, "C P N G"]:
        """Transfer vectors `sum_i e_i M_ij` of the glossy layer for P eyes, without specular."""
        local = ((values @ self.kernel) * self._seen()) @ self.harmonics
        world = self._turn(local.unsqueeze(-1), self.frames.permute(2, 1, 0))
        return world.movedim(-1, 0).mT

    def coefficients(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        """Exit coefficients `sum_j M_ij l_j` under lights of the world, without specular."""
        local = self._turn(light.unsqueeze(-3), self.frames.permute(2, 0, 1))
        arriving = (local.mT @ self.harmonics.mT) * self._seen().unsqueeze(-2)
        return (arriving @ self.kernel.mT).movedim(-3, -1).contiguous()

    def _seen(self) -> Tensor:
        """Visibility `[G, D]` at the nodes."""
        return self.visibility.mT @ self.functions.mT

    def _turn(self, light: Tensor, rotation: Tensor) -> Tensor:
        return self.turn(light, rotation) if torch.compiler.is_compiling() else rotate(light, rotation)
