"""Exit radiance from clustered transfer: lights meet representatives, receivers only weigh them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import embedding_bag

from torchprt.brdf import Brdf
from torchprt.errors import InputError
from torchprt.sh import Rotation
from torchprt.shade.diffuse import DiffuseShader
from torchprt.shade.glossy import FactoredShader, GlossyShader
from torchprt.shade.incident import IncidentShader
from torchprt.shade.view import ViewShader, matrix_vectors
from torchprt.shade.visibility import VisibilityShader
from torchprt.transfer import (
    ClusteredFactoredTransfer,
    ClusteredGlossyTransfer,
    ClusteredIncidentTransfer,
    ClusteredTransfer,
    ClusteredVisibilityTransfer,
    CompressedTransfer,
)


class Blend(nn.Module):
    """What receivers have of the representatives: `[V, P...]` sums of rows of a table.

    Buffers: `representatives [K + E, Q]`, or `[K + E, ...]` without shared axes (a parameter if it is learned),
    `shared [Q or 0, ...]`, and for `embedding_bag` int32 `rows`, `weights`, and `starts [V]`: of every receiver its
    mean, with 1, then the PCA vectors of its cluster. Weights stored as bytes are widened here.
    """

    representatives: Tensor
    shared: Tensor
    rows: Tensor
    weights: Tensor
    starts: Tensor

    def __init__(
        self, transfer: CompressedTransfer, dtype: torch.dtype, learned: bool = False, lost: Tensor | None = None
    ):
        """`lost [V]`: receivers that have nothing."""
        super().__init__()
        representatives, shared = transfer.representatives(dtype), transfer.shared.detach().to(dtype)
        if len(shared):
            shared = _streamed(shared)
        else:
            representatives = _streamed(representatives.unflatten(1, shared.shape[1:]))
        if learned:
            self.register_parameter("representatives", nn.Parameter(representatives.clone()))
        else:
            self.register_buffer("representatives", representatives)
        self.register_buffer("shared", shared)
        label = transfer.label.long()
        vectors, weights, starts = transfer.blend(dtype)
        device = label.device
        receivers = torch.arange(len(label), device=device)
        first = starts + receivers
        owner = receivers.repeat_interleave(transfer.counts[label])
        place = torch.arange(len(vectors), device=device) + owner + 1
        rows = torch.empty(len(label) + len(vectors), dtype=torch.int32, device=device)
        rows[first], rows[place] = label.int(), (len(transfer.mean) + vectors).int()
        blended = torch.empty(len(rows), dtype=dtype, device=device)
        blended[first], blended[place] = 1, weights
        if lost is not None and bool(lost.any()):
            blended[first[lost]] = 0
            blended[place[lost[owner]]] = 0
        self.register_buffer("rows", rows)
        self.register_buffer("weights", blended)
        self.register_buffer("starts", first.int())

    def forward(self, table: Float[Tensor, "R D"]) -> Float[Tensor, "V D"]:
        """The blend of the rows of `table`, one for each representative."""
        return embedding_bag(self.rows, table, self.starts, mode="sum", per_sample_weights=self.weights)

    def sent(self, product: Callable[[Tensor], Tensor]) -> Float[Tensor, "R D"]:
        """What every representative becomes under `product`, linear, of signals `[Q or R, ...]` to rows `[., D]`."""
        if len(self.shared):
            return self.representatives @ product(self.shared)
        return product(self.representatives)

    def signal(self) -> Tensor:
        """`[V, ...]`: the decompressed signal."""
        rows = self(self.representatives.flatten(1))
        return (rows @ self.shared.flatten(1) if len(self.shared) else rows).unflatten(1, self.shared.shape[1:])


class ClusteredShader(DiffuseShader):
    """Exit radiance of `ClusteredTransfer`, never decompressed.

    A light is applied to the representatives, or to the axes that they share; then every receiver sums the mean of
    its cluster and P weighted vectors: 3 (P + 1) multiplications a light, whatever its order. Called and turned as
    `DiffuseShader`; `out` is refused. `learn` may name "albedo" (without bounces) and "representatives".
    Source: Sloan, Hall, Hart and Snyder 2003, section 6.
    """

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
        self.blend = Blend(transfer, dtype, "representatives" in learn)
        albedo = transfer.albedo.detach().to(dtype)
        if "albedo" in learn:
            self.register_parameter("albedo", nn.Parameter(albedo.clone()))
        else:
            self.register_buffer("albedo", albedo)
        self.turn = Rotation(transfer.order, dtype).to(transfer.mean.device)
        self.order = transfer.order

    def extra_repr(self) -> str:
        return f"order={self.order}, representatives={len(self.blend.representatives)}"

    def _product(self, light: Tensor, out: Tensor | None) -> Tensor:
        """`[*B, 3, N]` to `[*B, 3, V]`."""
        if out is not None:
            raise InputError("out cannot be used with clustered transfer: leave it out")
        batch = light.shape[:-2]

        def product(signal: Tensor) -> Tensor:
            channels, count = signal.shape[1:]
            lights = light.movedim(-2, 0).reshape(channels, 3 // channels * math.prod(batch), count)
            return (lights @ signal.permute(1, 2, 0)).permute(2, 0, 1).reshape(len(signal), 3 * math.prod(batch))

        found = self.blend(self.blend.sent(product))
        return found.mT.reshape(3, *batch, len(found)).movedim(0, -2)


class ClusteredMatrix(ViewShader):
    """Mixed into a shader of stored matrices: the matrices are clustered, and never decompressed but to fix an eye.

    A light is applied to the representatives; every receiver sums the exit coefficients of its cluster's, and the eye
    comes last: 3 M (P + 1) multiplications a light instead of M N, whatever the order of the light. Many lights under
    one eye are where clusters gain least; `fix_eye` makes the vectors of that eye, as large as those of diffuse
    transfer, by decompressing the matrices once. Else as the shader of the kind that was compressed; `learn` may name
    "representatives" in place of "matrix".
    Source: Sloan, Hall, Hart and Snyder 2003, section 6.
    """

    blend: Blend

    def vectors(self, values: Float[Tensor, "P G M"]) -> Float[Tensor, "C P N G"]:
        """Transfer vectors of the glossy layer for P eyes, from the matrices, which are decompressed for it."""
        return matrix_vectors(self.blend.signal().transpose(0, 1), values)

    def coefficients(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        """Exit coefficients under lights of the world, without specular."""
        batch = light.shape[:-2]
        found = self.blend(self.blend.sent(lambda signal: _exits(signal, light)))
        return found.mT.reshape(3, *batch, self.blend.shared.shape[-2], len(found)).movedim(0, -3)

    def _glossy_layer(self, light: Tensor, values: Tensor) -> Tensor:
        lights, eyes = light.shape[:-2], values.shape[:-2]
        batch = torch.broadcast_shapes(lights, eyes)
        found = self.blend(self.blend.sent(lambda signal: _exits(signal, light)))
        receivers, rows = values.shape[-2:]
        if math.prod(eyes) == 1:
            # One product a receiver for all lights: half the time of products and sums.
            view = values.reshape(receivers, rows).contiguous().unsqueeze(-1)
            seen = torch.bmm(found.view(receivers, -1, rows), view)
            radiance = seen.view(receivers, 3, *lights).movedim((0, 1), (-1, -2)).expand(*batch, 3, receivers)
        else:
            padded = (1,) * (len(batch) - len(lights)) + lights
            exits = found.view(receivers, 3, *padded, rows).movedim(1, -2)
            views = values.movedim(-2, 0).reshape(receivers, *(1,) * (len(batch) - len(eyes)), *eyes, 1, rows)
            radiance = (exits * views).sum(-1).movedim(0, -1)
        return radiance * self.specular.T


class ClusteredGlossyShader(ClusteredMatrix, GlossyShader):
    """Exit radiance of `ClusteredGlossyTransfer`: `GlossyShader` with its matrices as in `ClusteredMatrix`."""

    def __init__(
        self, transfer: ClusteredGlossyTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
    ):
        _start(self, transfer, dtype, learn, {})
        self.output_order = transfer.output_order
        self.projection = transfer.projection


class ClusteredFactoredShader(ClusteredMatrix, FactoredShader):
    """Exit radiance of `ClusteredFactoredTransfer`: `FactoredShader` with its matrices as in `ClusteredMatrix`."""

    def __init__(
        self,
        transfer: ClusteredFactoredTransfer,
        *,
        dtype: torch.dtype | None = None,
        learn: Iterable[str] = (),
        views: Callable[[Tensor], Tensor] | None = None,
    ):
        _start(self, transfer, dtype, learn, {"factors": transfer.factors})
        self.views = views


class ClusteredIncidentShader(ClusteredMatrix, IncidentShader):
    """Exit radiance of `ClusteredIncidentTransfer`: `IncidentShader` with its matrices as in `ClusteredMatrix`."""

    def __init__(
        self,
        transfer: ClusteredIncidentTransfer,
        exponent: float | int | Tensor | None = None,
        *,
        brdf: Brdf | None = None,
        dtype: torch.dtype | None = None,
        learn: Iterable[str] = (),
    ):
        lobe = self.lobe(transfer, exponent, brdf)
        _start(self, transfer, dtype, learn, {} if lobe is None else {"exponent": lobe})
        self.reflect(transfer, brdf)


class ClusteredVisibilityShader(VisibilityShader):
    """Exit radiance of `ClusteredVisibilityTransfer`: `VisibilityShader` whose visibility is blended when it is used.

    `learn` may name "representatives" in place of "visibility".
    """

    blend: Blend

    def __init__(
        self, transfer: ClusteredVisibilityTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()
    ):
        _start(self, transfer, dtype, learn, {"kernel": transfer.kernel})
        self.tabulate(transfer.degree, transfer.visibility_order, transfer.output_order, transfer.projection)

    def _seen(self) -> Tensor:
        return self.blend(self.blend.sent(lambda signal: signal @ self.functions.mT))


def _start(
    shader: ViewShader,
    transfer: CompressedTransfer,
    dtype: torch.dtype | None,
    learn: Iterable[str],
    tensors: dict[str, Tensor],
) -> None:
    """The part of `ViewShader` and the blend of representatives, which `learn` may name."""
    assert not isinstance(transfer, ClusteredTransfer)
    learn = (learn,) if isinstance(learn, str) else tuple(learn)
    dtype = dtype or torch.promote_types(
        torch.promote_types(transfer.mean.dtype, transfer.diffuse.dtype), torch.float32
    )
    others = [name for name in learn if name != "representatives"]
    ViewShader.__init__(shader, transfer, dtype, others, tensors, "representatives")
    lost = transfer.normals[transfer.glossy.long()].abs().amax(-1) == 0
    shader.blend = Blend(transfer, dtype, "representatives" in learn, lost)


def _streamed(signal: Tensor) -> Tensor:
    """`signal [R, C, N]` or `[R, C, M, N]`, in memory as `[C, N, R]` or `[C, N, R, M]`: a light reads it as one stream,
    three times faster. Other signals as they are."""
    if signal.ndim == 3:
        return signal.permute(1, 2, 0).contiguous().permute(2, 0, 1)
    if signal.ndim == 4:
        return signal.permute(1, 3, 0, 2).contiguous().permute(2, 0, 3, 1)
    return signal


def _exits(signal: Float[Tensor, "R C M N"], light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "R D"]:
    """Exit coefficients `3 B M` of every row of `signal` under all lights."""
    total, channels, rows, columns = signal.shape
    many = math.prod(light.shape[:-2])
    lights = light.movedim(-1, 0).reshape(channels, 3 // channels * many, columns)
    found = lights @ signal.permute(1, 3, 0, 2).reshape(channels, columns, total * rows)
    return found.reshape(3 * many, total, rows).transpose(0, 1).flatten(1)
