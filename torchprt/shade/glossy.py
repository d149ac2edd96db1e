"""Exit radiance from stored matrices, in exit functions or in the factors of a BRDF."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import sample_hemisphere_map
from torchprt.sh import exit_functions
from torchprt.shade.view import ViewShader, matrix_coefficients, matrix_vectors, with_normals
from torchprt.transfer import FactoredTransfer, GlossyTransfer


class MatrixShader(ViewShader):
    """A `ViewShader` of transfer that stores `matrix [C, G, M, N]`."""

    matrix: Tensor

    def vectors(self, values: Float[Tensor, "P G M"]) -> Float[Tensor, "C P N G"]:
        """Transfer vectors `sum_i e_i M_ij` of the glossy layer for P eyes, without specular."""
        return matrix_vectors(self.matrix, values)

    def coefficients(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        """Exit coefficients `sum_j M_ij l_j` under lights of the world, without specular."""
        return matrix_coefficients(self.matrix, light)


class GlossyShader(MatrixShader):
    """Exit radiance of `GlossyTransfer`: e_i are the `sh.exit_functions` of its projection.

    Made by `torchprt.shader(transfer)`; `learn` may name "matrix", "specular", "albedo", "diffuse".
    Source: Sloan, Hall, Hart and Snyder 2003, section 3, equation 1.
    """

    def __init__(self, transfer: GlossyTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()):
        super().__init__(transfer, dtype, learn, {"matrix": with_normals(transfer, transfer.matrix)})
        self.output_order = transfer.output_order
        self.projection = transfer.projection

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """The exit functions of the local unit directions toward the eye."""
        return exit_functions(local, self.output_order, self.projection)


class FactoredShader(MatrixShader):
    """Exit radiance of `FactoredTransfer`: e_i are the factors of the BRDF, read from their table.

    `views`: called with local unit directions [*B, G, 3] instead of reading the table, to give [*B, G, M].
    Made by `torchprt.shader(transfer)`; `learn` may name "matrix", "factors", "specular", "albedo", "diffuse".
    Source: Sloan, Luna and Snyder 2005, section 5.
    """

    factors: Tensor

    def __init__(
        self,
        transfer: FactoredTransfer,
        *,
        dtype: torch.dtype | None = None,
        learn: Iterable[str] = (),
        views: Callable[[Tensor], Tensor] | None = None,
    ):
        matrix = with_normals(transfer, transfer.matrix)
        super().__init__(transfer, dtype, learn, {"matrix": matrix, "factors": transfer.factors})
        self.views = views

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """The factors at the local unit directions toward the eye."""
        return sample_hemisphere_map(self.factors, local) if self.views is None else self.views(local)
