"""Glossy exit radiance of surfaces that deform: the rows of a factored BRDF are zonal lobes."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from torchprt.brdf import sample_hemisphere_map
from torchprt.errors import InputError
from torchprt.sh import Rotation
from torchprt.shade.batches import light_product
from torchprt.shade.deformable import DeformableShader, beside, checked_pose, unit_axes
from torchprt.shade.diffuse import turned_light
from torchprt.shade.eye import local_frames, local_views, toward_eye
from torchprt.shade.frames import DeformedFrames
from torchprt.shade.glossy import FactoredShader
from torchprt.shade.lobes import lobe_vectors, turned_axes, turned_exact
from torchprt.transfer import FactoredTransfer, ZonalFactoredTransfer, ZonalTransfer

_LOBES = ("axis", "coefficients", "exact")


class DeformableFactoredShader(nn.Module):
    """Exit radiance of `ZonalFactoredTransfer` toward an eye in any pose, `albedo * diffuse + specular * glossy`.

    The glossy layer of a receiver is `sum_i u_i(v) M_i . light`: the rows M_i turn with its frame, v is the direction
    toward the eye in its turned local frame. The eye is applied to the coefficients of the lobes first; then all rows
    are one sum of M L lobes.

    Made by `torchprt.shader(transfer)`. Buffers, or parameters if named in `learn`: `axis`, `coefficients`, `exact`,
    `factors`, `specular`; with the submodule `diffuse` (a `DeformableShader`, None if nothing is diffuse) also its
    "albedo". With bounces albedo and specular were baked into what other surfaces receive: learning them is refused.
    Laws: those of `DeformableShader`, and frames, positions, light and eye turned together change nothing. Eyes below
    a tangent plane and receivers without a normal are those of `ViewShader`.
    Source: Sloan, Luna and Snyder 2005, section 5.
    """

    axis: Tensor
    coefficients: Tensor
    exact: Tensor
    factors: Tensor
    specular: Tensor
    points: Tensor
    local: Tensor
    glossy: Tensor

    def __init__(self, transfer: ZonalFactoredTransfer, *, dtype: torch.dtype | None = None, learn: Iterable[str] = ()):
        super().__init__()
        learn = (learn,) if isinstance(learn, str) else tuple(learn)
        names = (*_LOBES, "factors", "specular")
        has_diffuse = transfer.diffuse_axis.shape[-1] > 0
        known = [*names, "albedo"] if has_diffuse else list(names)
        unknown = sorted(set(learn) - set(known))
        if unknown:
            listed = ", ".join(f"'{name}'" for name in known)
            raise InputError(f"learn names '{unknown[0]}': a shader of {transfer.kind} transfer can learn {listed}")
        baked = sorted({"albedo", "specular"} & set(learn))
        if baked and transfer.bounces > 0:
            raise InputError(
                f"{baked[0]} cannot be learned: {transfer.bounces} bounces are baked with it into what other surfaces "
                "receive; bake without bounces"
            )
        dtype = dtype or torch.promote_types(transfer.coefficients.dtype, torch.float32)
        rows = transfer.glossy.long()
        frames, has_frame = local_frames(transfer.normals[rows], transfer.tangents)
        for name in names:
            value = getattr(transfer, name).detach()
            if name == "axis":
                value = unit_axes(value, 2)
            elif name in _LOBES:
                value = value * has_frame
            value = value.to(dtype)
            if name in learn:
                self.register_parameter(name, nn.Parameter(value.clone()))
            else:
                self.register_buffer(name, value)
        wide = torch.promote_types(transfer.positions.dtype, dtype)
        self.register_buffer("points", transfer.positions[rows].T.to(wide).contiguous())
        self.register_buffer("local", frames.permute(1, 2, 0).to(dtype).contiguous())
        self.register_buffer("glossy", rows)
        self.diffuse: DeformableShader | None = None
        if has_diffuse:
            layer = _diffuse_layer(transfer)
            self.diffuse = DeformableShader(layer, dtype=dtype, learn=[name for name in learn if name == "albedo"])
            self.estimate = self.diffuse.estimate
        else:
            self.estimate = DeformedFrames(transfer.positions, transfer.faces, normals=transfer.normals).to(dtype)
        self.turn = Rotation(transfer.order, dtype).to(transfer.positions.device)
        self.order = transfer.order
        self.vertices = transfer.vertices

    def extra_repr(self) -> str:
        rows, lobes, _, count = self.axis.shape
        return f"order={self.order}, factors={rows}, lobes={lobes}, vertices={self.vertices}, glossy={count}"

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"] | None = None,
        view: Float[Tensor, "*#B 3"] | None = None,
        frames: Float[Tensor, "*#B V 3 3"] | None = None,
        positions: Float[Tensor, "*#B V 3"] | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance of every receiver under every light, toward every eye, in every pose.

        `light`, `rotation`, `frames`, `positions`: as in `DeformableShader.forward`; `eye`, a point, or `view`, a
        direction, exactly one of them, as in `ViewShader.forward`. A point is seen from `positions`, so with `frames`
        it needs both. All batches broadcast. The result is a view with vertices contiguous.

        Raises InputError as those two, and if `eye` is given with `frames` alone.
        """
        if eye is not None and frames is not None and positions is None:
            raise InputError("eye is a point and frames are given without positions: give positions too, or a view")
        light = turned_light(light, rotation, self.turn)
        turned = checked_pose(frames, positions, self.estimate, self.coefficients.dtype)
        posed = None if turned is None else turned.index_select(-3, self.glossy)
        radiance = light_product(light, self.vectors(self.values(eye, view, posed, positions), posed))
        radiance = radiance * self.specular.T
        layer = None if self.diffuse is None else self.diffuse.radiance(light, turned)
        return self._spread(radiance, layer).mT

    def fix_pose(
        self, frames: Float[Tensor, "V 3 3"] | None = None, *, positions: Float[Tensor, "V 3"] | None = None
    ) -> FactoredShader:
        """The shader of one pose: its matrices and positions are stored. No gradients flow through it.

        With `frames` alone the receivers stay where they are at rest: then give `view`, not `eye`.
        Raises InputError as `forward`, and if there is more than one pose.
        """
        turned = checked_pose(frames, positions, self.estimate, self.coefficients.dtype)
        if turned is not None and turned.ndim != 3:
            raise InputError("frames or positions have a batch: fix one pose at a time")
        with torch.no_grad():
            return FactoredShader(self._posed(turned, positions), dtype=self.coefficients.dtype)

    def values(
        self, eye: Tensor | None, view: Tensor | None, posed: Tensor | None, positions: Tensor | None
    ) -> Float[Tensor, "*B G M"]:
        """The factors u_i toward an eye, for frames `posed [*P, G, 3, 3]` of the glossy receivers."""
        points = self.points
        if positions is not None and eye is not None:
            points = positions.index_select(-2, self.glossy).movedim(-1, 0)
            points = points.to(torch.promote_types(points.dtype, self.points.dtype))
        toward = _toward(points, eye, view).to(self.local.dtype)
        if posed is not None:
            turn = posed.movedim((-2, -1), (0, 1))
            batch = max(turn.ndim - 2, toward.ndim - 1)
            turn = turn.reshape(3, 3, *(1,) * (batch - turn.ndim + 2), *turn.shape[2:])
            toward = toward.reshape(3, *(1,) * (batch - toward.ndim + 1), *toward.shape[1:])
            # The transpose turns back into the rest pose.
            toward = (turn * toward.unsqueeze(1)).sum(0)
        return sample_hemisphere_map(self.factors, local_views(toward, self.local))

    def vectors(
        self, values: Float[Tensor, "*#B G M"], posed: Float[Tensor, "*#B G 3 3"] | None
    ) -> Float[Tensor, "C N ..."]:
        """Transfer vectors `[C, N, *B, G]` of the glossy layer toward eyes in poses, without specular."""
        axis = normalize(self.axis, dim=2) if isinstance(self.axis, nn.Parameter) else self.axis
        lanes = values.movedim(-1, 0)
        batch = max(lanes.ndim - 2, 0 if posed is None else posed.ndim - 3)
        lanes = lanes.reshape(len(lanes), *(1,) * (batch - lanes.ndim + 2), *lanes.shape[1:])
        if posed is not None:
            posed = posed.reshape(*(1,) * (batch - posed.ndim + 3), *posed.shape)
        rows, lobes = self.axis.shape[:2]
        weights = beside(self.coefficients, batch) * lanes[:, None, None]
        low = (beside(self.exact, batch) * lanes[:, None]).sum(1)
        if low.shape[1]:
            low = turned_exact(low, posed)
        axes = turned_axes(axis.flatten(0, 1), posed)
        if posed is None:
            axes = beside(axes, batch)
        return lobe_vectors(axes, weights.reshape(len(weights), rows * lobes, *weights.shape[3:]), low)

    def _spread(self, values: Tensor, layer: Tensor | None) -> Tensor:
        """Radiance `[*B, 3, G]` put among all receivers, over that of the diffuse layer."""
        if layer is None:
            layer = values.new_zeros(*values.shape[:-1], self.vertices)
        if len(self.glossy) == self.vertices:
            return layer + values
        batch = torch.broadcast_shapes(values.shape[:-1], layer.shape[:-1])
        places = self.glossy.expand(*batch, len(self.glossy))
        layer = layer.expand(*batch, self.vertices)
        return layer.scatter_add(-1, places, values.expand(*batch, len(self.glossy)))

    def _posed(self, turned: Tensor | None, positions: Tensor | None) -> FactoredTransfer:
        """The transfer of one pose."""
        posed = None if turned is None else turned.index_select(0, self.glossy)
        single = torch.eye(len(self.factors), dtype=self.local.dtype, device=self.local.device)
        count = len(self.glossy)
        rows = [self.vectors(row.expand(count, len(row)), posed) for row in single.unbind(0)]
        tangents, _, normals = self.local.unbind(0)
        if posed is not None:
            lanes = posed.permute(1, 2, 0)
            tangents, normals = ((lanes * part).sum(1) for part in (tangents, normals))
        shape = (self.vertices, 3)
        places = self.points.new_zeros(shape).index_copy(0, self.glossy, self.points.T)
        upright = normals.new_zeros(shape).index_copy(0, self.glossy, normals.T)
        layer, albedo = self.local.new_zeros(len(self.coefficients), self.order**2, 0), self.local.new_ones(1, 1)
        if self.diffuse is not None:
            layer, albedo = self.diffuse.vectors(turned), self.diffuse.albedo.detach()
        return FactoredTransfer(
            matrix=torch.stack(rows).permute(1, 3, 0, 2).contiguous(),
            factors=self.factors.detach(),
            specular=self.specular.detach(),
            diffuse=layer,
            albedo=albedo,
            glossy=self.glossy,
            tangents=tangents.T.contiguous(),
            normals=upright,
            positions=places if positions is None else positions.detach().to(places.dtype),
            faces=self.glossy.new_zeros(0, 3),
        )


def _diffuse_layer(transfer: ZonalFactoredTransfer) -> ZonalTransfer:
    shared = {name: getattr(transfer, name) for name in ("albedo", "positions", "normals", "faces")}
    return ZonalTransfer(
        axis=transfer.diffuse_axis,
        coefficients=transfer.diffuse_coefficients,
        exact=transfer.diffuse_exact,
        squared_error=transfer.diffuse_axis.new_zeros(transfer.vertices),
        **shared,
    )


def _toward(points: Tensor, eye: Tensor | None, view: Tensor | None) -> Float[Tensor, "3 ..."]:
    """World directions `[3, *B, G or 1]` from `points [3, *P, G]`, as `toward_eye`."""
    lanes = toward_eye(points.new_zeros(3, 1), eye, view)
    if eye is None:
        return lanes
    batch = max(lanes.ndim, points.ndim) - 2
    lanes = lanes.reshape(3, *(1,) * (batch - lanes.ndim + 2), *lanes.shape[1:])
    return lanes - points.reshape(3, *(1,) * (batch - points.ndim + 2), *points.shape[1:])
