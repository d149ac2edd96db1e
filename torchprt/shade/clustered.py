"""Exit radiance from clustered transfer: lights meet representatives, receivers only weigh them."""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import embedding_bag

from torchprt.errors import InputError
from torchprt.sh import Rotation, exit_functions
from torchprt.shade.diffuse import DiffuseShader
from torchprt.shade.view import ViewShader, matrix_vectors
from torchprt.transfer import ClusteredGlossyTransfer, ClusteredTransfer


class ClusteredShader(DiffuseShader):
    """Exit radiance of `ClusteredTransfer`, never decompressed.

    A light is applied to the K + E representatives `[R, C, N]`; then every receiver sums the mean of its cluster and
    P weighted vectors: 3 (P + 1) multiplications a light, whatever its order. Called and turned as `DiffuseShader`;
    `out` is refused. `learn` may name "albedo" (without bounces) and "representatives".
    Source: Sloan, Hall, Hart and Snyder 2003, section 6.
    """

    representatives: Tensor
    rows: Tensor
    weights: Tensor

    def __init__(self, transfer: ClusteredTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()):
        nn.Module.__init__(self)
        learn = (learn,) if isinstance(learn, str) else tuple(learn)
        unknown = sorted(set(learn) - {"albedo", "representatives"})
        if unknown:
            raise InputError(f"learn names '{unknown[0]}': a clustered shader can learn 'albedo' and 'representatives'")
        if "albedo" in learn and transfer.bounces > 0:
            raise InputError(
                f"albedo cannot be learned: {transfer.bounces} bounces are baked with it into what other surfaces "
                "receive; bake without bounces"
            )
        dtype = dtype or torch.promote_types(transfer.mean.dtype, torch.float32)
        rows, weights = blend(transfer, dtype)
        for name, value in (
            ("representatives", torch.cat([transfer.mean, transfer.basis]).detach().to(dtype)),
            ("albedo", transfer.albedo.detach().to(dtype)),
        ):
            if name in learn:
                self.register_parameter(name, nn.Parameter(value.clone()))
            else:
                self.register_buffer(name, value)
        self.register_buffer("rows", rows)
        self.register_buffer("weights", weights)
        self.turn = Rotation(transfer.order, dtype).to(transfer.mean.device)
        self.order = transfer.order

    def extra_repr(self) -> str:
        return f"order={self.order}, representatives={len(self.representatives)}, vertices={len(self.rows)}"

    def _product(self, light: Tensor, out: Tensor | None) -> Tensor:
        """`[*B, 3, N]` to `[*B, 3, V]`."""
        if out is not None:
            raise InputError("out cannot be used with clustered transfer: leave it out")
        batch = light.shape[:-2]
        channels, count = self.representatives.shape[1:]
        lights = light.movedim(-2, 0).reshape(channels, 3 // channels * math.prod(batch), count)
        # `[C, R, 3 / C * B]`: what every representative sends under every light.
        sent = self.representatives.transpose(0, 1) @ lights.mT
        table = sent.transpose(0, 1).reshape(len(self.representatives), 3 * math.prod(batch))
        found = embedding_bag(self.rows, table, mode="sum", per_sample_weights=self.weights)
        return found.mT.reshape(3, *batch, len(self.rows)).movedim(0, -2)


class ClusteredGlossyShader(ViewShader):
    """Exit radiance of `ClusteredGlossyTransfer`, never decompressed but to fix an eye.

    A light is applied to the representatives; every receiver sums the exit coefficients of its cluster's, and the eye
    comes last: 3 M (P + 1) multiplications a light instead of M N, whatever the order of the light. Many lights under
    one eye are where `ClusteredGlossyTransfer` gains least; `fix_eye` makes the vectors of that eye, as large as those
    of diffuse transfer, by decompressing the matrices once. Exit functions are those of `GlossyShader`.
    Made by `torchprt.shader(transfer)`; `learn` may name "representatives", "specular", "albedo", "diffuse".
    Source: Sloan, Hall, Hart and Snyder 2003, section 6.
    """

    representatives: Tensor
    rows: Tensor
    weights: Tensor

    def __init__(
        self, transfer: ClusteredGlossyTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
    ):
        dtype = dtype or torch.promote_types(transfer.mean.dtype, transfer.diffuse.dtype)
        dtype = torch.promote_types(dtype, torch.float32)
        super().__init__(transfer, dtype, learn, {"representatives": torch.cat([transfer.mean, transfer.basis])})
        rows, weights = blend(transfer, dtype)
        lost = transfer.normals[transfer.glossy.long()].abs().amax(-1) == 0
        self.register_buffer("rows", rows)
        self.register_buffer("weights", weights.masked_fill(lost[:, None], 0))
        self.output_order = transfer.output_order
        self.projection = transfer.projection

    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """The exit functions of the local unit directions toward the eye."""
        return exit_functions(local, self.output_order, self.projection)

    def vectors(self, values: Float[Tensor, "P G M"]) -> Float[Tensor, "C P N G"]:
        """Transfer vectors of the glossy layer for P eyes, from the matrices, which are decompressed for it."""
        table = self.representatives.flatten(1)
        matrix = embedding_bag(self.rows, table, mode="sum", per_sample_weights=self.weights)
        return matrix_vectors(matrix.unflatten(1, self.representatives.shape[1:]).transpose(0, 1), values)

    def coefficients(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        """Exit coefficients under lights of the world, without specular."""
        batch = light.shape[:-2]
        total, channels, rows, columns = self.representatives.shape
        lights = light.movedim(-1, 0).reshape(channels, 3 // channels * math.prod(batch), columns)
        sent = lights @ self.representatives.transpose(0, 1).reshape(channels, total * rows, columns).mT
        # `[3 B, R, M]` to one row a representative.
        table = sent.reshape(3 * math.prod(batch), total, rows).transpose(0, 1).flatten(1)
        found = embedding_bag(self.rows, table, mode="sum", per_sample_weights=self.weights)
        return found.mT.reshape(3, *batch, rows, len(self.rows)).movedim(0, -3)

    def _glossy_layer(self, light: Tensor, values: Tensor) -> Tensor:
        radiance = (self.coefficients(light) * values.mT.unsqueeze(-3)).sum(-2)
        return radiance * self.specular.T


def blend(
    transfer: ClusteredTransfer | ClusteredGlossyTransfer, dtype: torch.dtype
) -> tuple[Tensor, Float[Tensor, "V R"]]:
    """For every receiver the rows of its representatives among means, then PCA vectors, and their weights: the mean
    with 1, then as many vectors as its cluster has; weight 0 after them. Indices are int32, as for `embedding_bag`."""
    label, offsets = transfer.label.long(), transfer.offsets.long()
    place = torch.arange(transfer.weights.shape[1], device=label.device)
    real = place < offsets.diff()[label][:, None]
    vectors = torch.where(real, len(transfer.mean) + offsets[label][:, None] + place, label[:, None])
    rows = torch.cat([label[:, None], vectors], 1).to(torch.int32)
    weights = torch.where(real, transfer.weights, 0).to(dtype)
    return rows, torch.cat([weights.new_ones(len(label), 1), weights], 1)
