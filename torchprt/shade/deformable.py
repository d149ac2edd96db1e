"""Exit radiance of surfaces that deform: zonal lobes turn with them, by turning their axes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal, get_args

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import normalize

from torchprt.errors import InputError
from torchprt.sh import Rotation, check_rotation
from torchprt.sh.basis import values_are_at_hand
from torchprt.shade.batches import light_product
from torchprt.shade.diffuse import DiffuseShader, turned_light
from torchprt.shade.frames import DeformedFrames
from torchprt.shade.lobes import lobe_vectors, table_radiance, turned_axes, turned_exact
from torchprt.transfer import ZonalTransfer

Method = Literal["direct", "table"]


class DeformableShader(nn.Module):
    """Exit radiance of `ZonalTransfer` in any pose, `albedo * lobes turned by frames . D(rotation) light`.

    Made by `torchprt.shader(transfer)`. Buffers `axis [L, 3, V]`, `coefficients [C, L, Z, V]`, `exact [C, J, V]`,
    `albedo [V or 1, 3 or 1]`, each a parameter instead if it is named in `learn`; learned axes count as unit vectors.
    With bounces the albedo was also baked into what other surfaces receive, so learning it is refused.

    `method`: "direct" makes the transfer vectors of a pose and applies the light to them: exact. "table" reads each
    lobe from a table of the light, as the paper's vertex shader: off by up to 3 % of a band (`lobes.table_radiance`),
    and slower on a CPU unless there are few lobes; it never holds N numbers a receiver.

    Laws: linear in `light`; frames R F under the light D(R) give the same radiance; identity frames give the transfer
    that was fitted; channels do not mix. Shadows do not follow the pose, only turn with the surface.
    Source: Sloan, Luna and Snyder 2005, section 4.
    """

    axis: Tensor
    coefficients: Tensor
    exact: Tensor
    albedo: Tensor

    def __init__(
        self,
        transfer: ZonalTransfer,
        *,
        method: Method = "direct",
        dtype: torch.dtype | None = None,
        learn: Iterable[str] = (),
    ):
        super().__init__()
        learn = (learn,) if isinstance(learn, str) else tuple(learn)
        names = ("axis", "coefficients", "exact", "albedo")
        unknown = sorted(set(learn) - set(names))
        if unknown:
            known = ", ".join(f"'{name}'" for name in names)
            raise InputError(f"learn names '{unknown[0]}': a deformable shader can learn {known}")
        if "albedo" in learn and transfer.bounces > 0:
            raise InputError(
                f"albedo cannot be learned: {transfer.bounces} bounces are baked with it into what other surfaces "
                "receive; bake without bounces"
            )
        if method not in get_args(Method):
            raise InputError(f"method '{method}' is unknown: use 'direct' or 'table'")
        self.method = method
        dtype = dtype or torch.promote_types(transfer.coefficients.dtype, torch.float32)
        for name in names:
            value = getattr(transfer, name).detach()
            value = (unit_axes(value, 1) if name == "axis" else value).to(dtype)
            if name in learn:
                self.register_parameter(name, nn.Parameter(value.clone()))
            else:
                self.register_buffer(name, value)
        self.estimate = DeformedFrames(transfer.positions, transfer.faces, normals=transfer.normals).to(dtype)
        self.turn = Rotation(transfer.order, dtype).to(transfer.axis.device)
        self.order = transfer.order

    def extra_repr(self) -> str:
        lobes, _, vertices = self.axis.shape
        return f"order={self.order}, lobes={lobes}, vertices={vertices}, method={self.method}"

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        frames: Float[Tensor, "*#B V 3 3"] | None = None,
        positions: Float[Tensor, "*#B V 3"] | None = None,
    ) -> Float[Tensor, "... V 3"]:
        """Linear exit radiance of every receiver under every light, in every pose; the batches broadcast.

        `light [..., N, 3]`; `rotation [..., 3, 3]` turns the environment, not the surface (identity if omitted).
        `frames [..., V, 3, 3]`: the rotation of every receiver from the rest pose; or `positions [..., V, 3]` of the
        deformed mesh, from which they are estimated (`DeformedFrames`); frames count if both are given, the rest pose
        if neither is. Fastest where many lights have size 1 in the batch of the pose; every other pose takes C N V
        numbers of memory. The result is a view with vertices contiguous.

        Raises InputError if the light is not of the order of the transfer, there are not as many frames or positions
        as receivers or, outside a traced graph, if frames or `rotation` are not proper rotations within 1e-4 (a
        collapsed or mirrored one is none), or positions are not finite.
        """
        light = turned_light(light, rotation, self.turn)
        return self.radiance(light, self.pose(frames, positions)).mT

    def radiance(
        self, light: Float[Tensor, "*#B N 3"], frames: Float[Tensor, "*#B V 3 3"] | None
    ) -> Float[Tensor, "... 3 V"]:
        """Radiance under lights that are turned, in poses that are checked."""
        if self.albedo.shape[0] == 1:
            light = light * self.albedo
        if self.method == "direct":
            radiance = light_product(light, self.vectors(frames))
        else:
            radiance = table_radiance(light, *self.lobes(frames))
        return radiance if self.albedo.shape[0] == 1 else radiance * self.albedo.T

    def fix_pose(
        self, frames: Float[Tensor, "V 3 3"] | None = None, *, positions: Float[Tensor, "V 3"] | None = None
    ) -> FixedPoseShader:
        """A shader for lights alone in one pose: its transfer vectors are stored, and it costs what a static one does.

        Equal to the general call to rounding. Stores C N V numbers. Gradients flow through it to the frames and the
        parameters of this shader. Raises InputError as `forward`, and if there is more than one pose.
        """
        frames = self.pose(frames, positions)
        if frames is not None and frames.ndim != 3:
            raise InputError("frames or positions have a batch: fix one pose at a time")
        return FixedPoseShader(self.vectors(frames), self.albedo, self.turn)

    def vectors(self, frames: Float[Tensor, "*P V 3 3"] | None) -> Float[Tensor, "C N ..."]:
        """Transfer vectors `[C, N, *P, V]` in every pose, without albedo; `frames` are not checked."""
        return lobe_vectors(*self.lobes(frames))

    def lobes(self, frames: Float[Tensor, "*P V 3 3"] | None) -> tuple[Tensor, Tensor, Tensor]:
        """Axes, coefficients, and bands 0 and 1 where they are exact, in every pose, as `lobe_vectors` takes them."""
        axis = normalize(self.axis, dim=1) if isinstance(self.axis, nn.Parameter) else self.axis
        poses = 0 if frames is None else frames.ndim - 3
        low = beside(self.exact, poses)
        if low.shape[1]:
            low = turned_exact(low, frames)
        return turned_axes(axis, frames), beside(self.coefficients, poses), low

    def pose(self, frames: Tensor | None, positions: Tensor | None) -> Float[Tensor, "*P V 3 3"] | None:
        """The frames of a pose, checked, in the dtype of the shader; None for the rest pose."""
        return checked_pose(frames, positions, self.estimate, self.coefficients.dtype)


class FixedPoseShader(DiffuseShader):
    """Exit radiance in one pose; made by `DeformableShader.fix_pose`. A `DiffuseShader` in everything."""

    def __init__(self, vectors: Float[Tensor, "C N V"], albedo: Tensor, turn: Rotation):
        nn.Module.__init__(self)
        self.register_buffer("transfer", vectors.contiguous())
        self.register_buffer("albedo", albedo)
        self.turn = turn
        self.order = turn.order


def checked_pose(
    frames: Tensor | None, positions: Tensor | None, estimate: DeformedFrames, dtype: torch.dtype
) -> Float[Tensor, "*P V 3 3"] | None:
    """`frames`, or else those of `positions`, in `dtype`; None without either. Raises InputError as `forward`."""
    if frames is not None:
        if frames.shape[-3:] != (estimate.vertices, 3, 3):
            raise InputError(
                f"frames have shape {list(frames.shape)}: the transfer has {estimate.vertices} receivers, give "
                f"[..., {estimate.vertices}, 3, 3]"
            )
        if values_are_at_hand():
            check_rotation(frames, "frames")
        return frames.to(dtype)
    if positions is None:
        return None
    if values_are_at_hand() and not bool(positions.isfinite().all()):
        raise InputError("positions hold NaN or infinity: give finite numbers")
    return estimate(positions).to(dtype)


def unit_axes(axis: Tensor, dim: int) -> Tensor:
    """Axes in the dtype of a shader, of unit length again if they were stored in half precision."""
    if axis.dtype in (torch.float16, torch.bfloat16):
        return normalize(axis.double(), dim=dim)
    return axis


def beside(values: Tensor, poses: int) -> Tensor:
    """`values [..., V]` with `poses` dimensions of size 1 before the last."""
    return values.reshape(*values.shape[:-1], *(1,) * poses, values.shape[-1])
