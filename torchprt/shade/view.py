"""What all shaders of glossy transfer share: a diffuse layer, and on some receivers a layer that depends on the eye."""

from __future__ import annotations

import abc
import math
from collections.abc import Iterable, Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.sh import Rotation
from torchprt.shade.diffuse import DiffuseShader, turned_light
from torchprt.shade.eye import local_frames, local_views, toward_eye
from torchprt.shade.fixed import FixedEyeShader, FixedLightShader
from torchprt.transfer import (
    ClusteredFactoredTransfer,
    ClusteredGlossyTransfer,
    ClusteredIncidentTransfer,
    ClusteredVisibilityTransfer,
    DiffuseTransfer,
    FactoredTransfer,
    GlossyTransfer,
    IncidentTransfer,
    VisibilityTransfer,
)

ViewTransfer = (
    GlossyTransfer
    | FactoredTransfer
    | IncidentTransfer
    | VisibilityTransfer
    | ClusteredGlossyTransfer
    | ClusteredFactoredTransfer
    | ClusteredIncidentTransfer
    | ClusteredVisibilityTransfer
)


class ViewShader(nn.Module, abc.ABC):
    """Exit radiance toward an eye: `albedo * diffuse layer + specular * glossy layer`, the latter where there is one.

    The glossy layer of a receiver is `sum_i e_i(v) sum_j M_ij l_j`, v the local direction toward the eye. Subclasses
    say what e_i are (`exit_values`) and what M is (`vectors`, `coefficients`). The eye is contracted first: what is
    left is a transfer vector, and every further light of the same eye costs what a diffuse one does.

    Buffers, or parameters if named in `learn`: `specular [G or 1, 3 or 1]`, those of the subclass, and those of the
    submodule `diffuse` (a `DiffuseShader`, None if no receiver has a diffuse layer), where "albedo" is its albedo and
    "diffuse" its transfer. With bounces albedo and specular were also baked into what other surfaces receive, so
    learning them is refused. `points [3, G]` are in the dtype of the positions, if that is wider.

    Laws: linear in `light`; turning the light and asking for `rotation` are the same; channels do not mix. An eye
    below the tangent plane of a receiver counts as on it, an eye at a receiver as above it (`local_views`); a
    receiver whose normal is zero has no glossy layer. Directions are computed from eye - position in the dtype of
    the wider: in float32 they err by about 6e-8 (|eye| + |position|) / distance, so scenes far from the origin want
    positions and eye in float64; nothing but the subtraction is then done in it.
    """

    points: Tensor
    frames: Tensor
    glossy: Tensor
    specular: Tensor

    def __init__(
        self,
        transfer: ViewTransfer,
        dtype: torch.dtype | None,
        learn: Iterable[str],
        tensors: dict[str, Tensor],
        *also: str,
    ):
        """`tensors`: what the subclass holds, by name; receivers without a normal are already zero in them.

        `also`: what else can be learned, which the subclass sees to; not in `learn`.
        """
        super().__init__()
        learn = (learn,) if isinstance(learn, str) else tuple(learn)
        tensors = {**tensors, "specular": transfer.specular}
        known = [*tensors, "albedo", "diffuse"] if transfer.diffuse.shape[2] else list(tensors)
        unknown = sorted(set(learn) - set(known))
        if unknown:
            names = ", ".join(f"'{name}'" for name in sorted([*known, *also]))
            raise InputError(f"learn names '{unknown[0]}': a shader of {transfer.kind} transfer can learn {names}")
        baked = sorted({"albedo", "specular"} & set(learn))
        if baked and transfer.bounces > 0:
            raise InputError(
                f"{baked[0]} cannot be learned: {transfer.bounces} bounces are baked with it into what other surfaces "
                "receive; bake without bounces"
            )
        dtype = dtype or widened(transfer)
        for name, value in tensors.items():
            value = value.detach().to(dtype)
            if name in learn:
                self.register_parameter(name, nn.Parameter(value.clone()))
            else:
                self.register_buffer(name, value)
        places = transfer.positions[transfer.glossy.long()]
        frames, _ = local_frames(transfer.normals[transfer.glossy.long()], transfer.tangents)
        self.register_buffer("points", places.T.to(torch.promote_types(places.dtype, dtype)).contiguous())
        self.register_buffer("frames", frames.permute(1, 2, 0).to(dtype).contiguous())
        self.register_buffer("glossy", transfer.glossy.long())
        self.diffuse: DiffuseShader | None = None
        if transfer.diffuse.shape[2]:
            layer = DiffuseTransfer(
                transfer=transfer.diffuse,
                albedo=transfer.albedo,
                positions=transfer.positions,
                normals=transfer.normals,
                faces=transfer.faces,
            )
            inner = {"albedo": "albedo", "diffuse": "transfer"}
            self.diffuse = DiffuseShader(layer, dtype=dtype, learn=[inner[name] for name in learn if name in inner])
        self.turn = Rotation(transfer.order, dtype).to(transfer.positions.device)
        self.order = transfer.order
        self.vertices = transfer.vertices

    def extra_repr(self) -> str:
        return f"order={self.order}, vertices={self.vertices}, glossy={len(self.glossy)}"

    @abc.abstractmethod
    def exit_values(self, local: Float[Tensor, "*B G 3"]) -> Float[Tensor, "*B G M"]:
        """The functions e_i of the local unit directions toward the eye."""

    @abc.abstractmethod
    def vectors(self, values: Float[Tensor, "P G M"]) -> Float[Tensor, "C P N G"]:
        """Transfer vectors `sum_i e_i M_ij` of the glossy layer for P eyes, without specular."""

    @abc.abstractmethod
    def coefficients(self, light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
        """Exit coefficients `sum_j M_ij l_j` under lights of the world, without specular."""

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance of every receiver under every light, toward every eye.

        `light [..., N, 3]`; `rotation [..., 3, 3]` turns the environment (identity if omitted); exactly one of
        `eye [..., 3]`, a point in the unit of the scene, and `view [..., 3]`, the direction toward a distant eye, of
        any length above zero. The batches broadcast. Fastest where the dimensions of many lights have size 1 in the
        eye: the eye is then applied to the transfer once. Every other eye takes C N G numbers of memory on the way.
        The result is a view with vertices contiguous.

        Raises InputError if the light is not of the order of the transfer, not exactly one of `eye` and `view` is
        given or, outside a traced graph, if one is not finite or `view` is zero, or `rotation` is not a proper
        rotation within 1e-4.
        """
        light = turned_light(light, rotation, self.turn)
        values = self.values(eye, view)
        radiance = self._glossy_layer(light, values)
        return self.spread(radiance, None if self.diffuse is None else self.diffuse(light).mT).mT

    def fix_eye(
        self, *, eye: Float[Tensor, "3"] | None = None, view: Float[Tensor, "3"] | None = None
    ) -> FixedEyeShader:
        """A shader for lights alone, with one `eye` or `view`: a diffuse product, all layers and weights inside.

        Equal to the general call to rounding. Stores `[C, N, V]` numbers, C = 3 if albedo, specular or transfer
        have three channels. Gradients flow through it to the eye and the parameters of this shader.
        Raises InputError as `forward`, and if more than one eye is given.
        """
        values = self.values(eye, view)
        if values.ndim != 2:
            raise InputError("eye or view has a batch: fix one at a time, of shape [3]")
        total = self.vectors(values.unsqueeze(0))[:, 0] * self.specular.T.unsqueeze(1)
        layer = None
        if self.diffuse is not None:
            layer = self.diffuse.transfer * self.diffuse.albedo.T.unsqueeze(1)
        return FixedEyeShader(self.spread(total, layer), self.turn)

    def fix_light(
        self, light: Float[Tensor, "*#B N 3"], rotation: Float[Tensor, "*#B 3 3"] | None = None
    ) -> FixedLightShader:
        """A shader for eyes alone, under one light or a batch: exit coefficients and diffuse radiance are stored.

        Equal to the general call to rounding. Stores 3 (M G + V) numbers a light. Gradients flow through it to the
        light and the parameters of this shader. Raises InputError as `forward`.
        """
        light = turned_light(light, rotation, self.turn)
        stored = self.coefficients(light) * self.specular.T.unsqueeze(-2)
        return FixedLightShader(self, stored, None if self.diffuse is None else self.diffuse(light).mT)

    def values(self, eye: Tensor | None, view: Tensor | None) -> Float[Tensor, "*B G M"]:
        """`exit_values` toward an eye; InputError as `forward`."""
        toward = toward_eye(self.points, eye, view)
        return self.exit_values(local_views(toward.to(self.frames.dtype), self.frames))

    def spread(self, values: Float[Tensor, "*#B G"], layer: Float[Tensor, "*#B V"] | None) -> Float[Tensor, "... V"]:
        """Values of the glossy receivers put among all of them, over those of the diffuse `layer`."""
        if len(self.glossy) == self.vertices:
            return values if layer is None else layer + values
        if layer is None:
            layer = values.new_zeros(*values.shape[:-1], self.vertices)
        batch = torch.broadcast_shapes(values.shape[:-1], layer.shape[:-1])
        # Three times faster than index_add here, and no receiver is named twice.
        places = self.glossy.expand(*batch, len(self.glossy))
        layer = layer.expand(*batch, self.vertices)
        return layer.scatter_add(-1, places, values.expand(*batch, len(self.glossy)))

    def _glossy_layer(self, light: Tensor, values: Tensor) -> Tensor:
        """Radiance `[*B, 3, G]` of the glossy layer from `light [*B, N, 3]` and exit values `[*B, G, M]`."""
        batch = torch.broadcast_shapes(light.shape[:-2], values.shape[:-2])
        eyes = (1,) * (len(batch) - values.ndim + 2) + values.shape[:-2]
        # Dimensions along which the eye changes are those of a batched product; all others add lights to it.
        paired = [axis for axis, size in enumerate(eyes) if size != 1]
        shared = [axis for axis, size in enumerate(eyes) if size == 1]
        count = math.prod([batch[axis] for axis in paired])
        receivers = len(self.glossy)
        vectors = self.vectors(values.reshape(count, *values.shape[-2:]))
        if len(self.specular) == 1:
            # One weight for all receivers: applied to N numbers instead of G.
            light = light * self.specular
        rows = light.mT.expand(*batch, 3, light.shape[-2])
        colour = len(batch)
        order = [colour, *paired, *shared] if len(vectors) == 3 else [*paired, *shared, colour]
        sizes = [(*batch, 3)[axis] for axis in order]
        matrices = vectors.reshape(len(vectors) * count, *vectors.shape[2:])
        rows = rows.permute(*order, -1).reshape(
            len(matrices), math.prod(sizes) // max(len(matrices), 1), light.shape[-2]
        )
        radiance = torch.bmm(rows, matrices).view(*sizes, receivers).permute(*_inverse(order), -1)
        return radiance if len(self.specular) == 1 else radiance * self.specular.T


def widened(transfer: ViewTransfer) -> torch.dtype:
    """float32, or wider if a tensor of the transfer that a product reads is."""
    dtype = torch.float32
    for name in ("diffuse", "matrix", "visibility"):
        if hasattr(transfer, name):
            dtype = torch.promote_types(dtype, getattr(transfer, name).dtype)
    return dtype


def with_normals(transfer: ViewTransfer, values: Tensor) -> Tensor:
    """`values [., G, ...]`, zero for the receivers whose normal is zero; the same tensor if there are none."""
    lost = transfer.normals[transfer.glossy.long()].abs().amax(-1) == 0
    return values if not bool(lost.any()) else values.index_fill(1, lost.nonzero()[:, 0], 0)


def matrix_vectors(matrix: Float[Tensor, "C G M N"], values: Float[Tensor, "P G M"]) -> Float[Tensor, "C P N G"]:
    """`sum_i values_i matrix_ij`: one product a receiver, which reads the matrices once for all P."""
    channels, receivers, rows, columns = matrix.shape
    # Copied in this order: a product of strided exit values is ten times slower.
    left = values.transpose(0, 1).contiguous().expand(channels, receivers, len(values), rows)
    pairs = channels * receivers
    flat = torch.bmm(left.reshape(pairs, len(values), rows), matrix.reshape(pairs, rows, columns))
    return flat.view(channels, receivers, len(values), columns).permute(0, 2, 3, 1)


def matrix_coefficients(matrix: Float[Tensor, "C G M N"], light: Float[Tensor, "*B N 3"]) -> Float[Tensor, "*B 3 M G"]:
    """`sum_j matrix_ij light_j`, vertices last."""
    channels, receivers, rows, columns = matrix.shape
    batch = light.shape[:-2]
    lights = light.mT.movedim(-2, 0).reshape(3, math.prod(batch), columns)
    lights = lights.reshape(channels, 3 // channels * math.prod(batch), columns)
    flat = torch.bmm(lights, matrix.view(channels, receivers * rows, columns).mT)
    return flat.view(3, *batch, receivers, rows).movedim(0, -3).mT.contiguous()


def _inverse(order: Sequence[int]) -> list[int]:
    return sorted(range(len(order)), key=order.__getitem__)
