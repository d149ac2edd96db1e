"""A mesh that follows the joints of a skeleton."""

from __future__ import annotations

from jaxtyping import Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.pose.frames import nearest_rotation
from torchprt.sh.basis import values_are_at_hand
from torchprt.sh.precision import KeepsSingle, widened, without_autocast


class SkinnedMesh(KeepsSingle):
    """Linear blend skinning: where the vertices are, and how they have turned, from the transforms of joints.

    The transform of a vertex is the weighted mean of those of its joints; its frame is the rotation nearest to the
    linear part of that mean (`nearest_rotation`), so it stays proper where joints twist against each other, and where
    joints scale. Joints that mirror have no rotation to give: what they blend to gets the nearest proper one.

    `positions [V, 3]`: rest pose. `weights [V, J]`, zero or more, each row summing to 1 within 1e-4; or, with
    `joints [V, K]`, weights `[V, K]` of those joints, of which there are `joint_count` (one more than the largest
    named, if omitted). Weights become `[V, J]`, in the dtype of the positions.

    Laws: equal transforms move the mesh rigidly; identities leave it as it is; gradients flow to the transforms.
    Raises InputError if shapes do not fit, a weight is negative, a row does not sum to 1, or a joint is not there.
    Source: Magnenat-Thalmann, Laperrière and Thalmann 1988, "Joint-dependent local deformations for hand animation and
    object grasping"; Sloan, Luna and Snyder 2005, section 6 (the bat).
    """

    single = ("positions", "weights")
    positions: Tensor
    weights: Tensor

    def __init__(
        self,
        positions: Float[Tensor, "V 3"],
        weights: Float[Tensor, "V K"],
        joints: Int[Tensor, "V K"] | None = None,
        *,
        joint_count: int | None = None,
    ) -> None:
        super().__init__()
        if len(weights) != len(positions):
            raise InputError(
                f"weights are for {len(weights)} vertices, positions for {len(positions)}: give a row each"
            )
        if not bool(positions.isfinite().all()):
            raise InputError("positions hold NaN or infinity: give finite numbers")
        off = ~((weights.sum(-1) - 1).abs() <= 1e-4) | ~(weights >= 0).all(-1)
        if bool(off.any()):
            raise InputError(
                f"weights of {int(off.sum())} vertices are negative or do not sum to 1 within 1e-4: normalise them"
            )
        if joints is None:
            if joint_count not in (None, weights.shape[1]):
                raise InputError(f"weights are of {weights.shape[1]} joints but joint_count is {joint_count}")
        else:
            weights = _spread(weights, joints, joint_count)
        self.register_buffer("positions", positions.detach())
        self.register_buffer("weights", weights.detach().to(positions.dtype))

    def extra_repr(self) -> str:
        return f"vertices={len(self.weights)}, joints={self.weights.shape[1]}"

    def forward(
        self, transforms: Float[Tensor, "*B J 4 4"]
    ) -> tuple[Float[Tensor, "*B V 3"], Float[Tensor, "*B V 3 3"]]:
        """Positions and frames of poses; `transforms` take each joint from the rest pose to the pose, as column
        vectors (the posed joint times its inverse bind matrix). Memory has vertices last.

        Raises InputError if there are not as many transforms as joints or, outside a traced graph, one is not finite
        or not affine (last row 0, 0, 0, 1).
        """
        count = self.weights.shape[1]
        if transforms.shape[-3:] != (count, 4, 4):
            raise InputError(
                f"transforms have shape {list(transforms.shape)}: there are {count} joints, give [..., {count}, 4, 4]"
            )
        if values_are_at_hand():
            bottom = transforms.new_tensor([0.0, 0.0, 0.0, 1.0])
            if not bool(transforms.isfinite().all() & (transforms[..., 3, :] - bottom).abs().le(1e-4).all()):
                raise InputError("transforms must be finite, with a last row of 0, 0, 0, 1: give affine matrices")
        rows = widened(transforms[..., :3, :]).movedim(-3, -1)
        blended = _blended(rows, self.weights.mT.to(rows.dtype))
        blended = blended.movedim((-3, -2), (0, 1))
        points = self.positions.mT.to(rows.dtype)
        points = points.reshape(3, *(1,) * (blended.ndim - 3), points.shape[-1])
        moved = (blended[:, :3] * points).sum(1) + blended[:, 3]
        frames = nearest_rotation(blended[:, :3].movedim((0, 1), (-2, -1)))
        return moved.movedim(0, -1), frames


@without_autocast
def _blended(rows: Tensor, weights: Tensor) -> Tensor:
    return rows @ weights


def _spread(weights: Tensor, joints: Tensor, count: int | None) -> Tensor:
    """Weights `[V, K]` of named joints as `[V, J]`; a joint that is named twice adds up."""
    if joints.shape != weights.shape:
        raise InputError(f"joints have shape {list(joints.shape)} but weights {list(weights.shape)}: give one each")
    largest = int(joints.max()) if joints.numel() else -1
    if joints.numel() and (int(joints.min()) < 0 or (count is not None and largest >= count)):
        raise InputError(f"joints name {largest} or a negative one, but there are {count}: count them from 0")
    empty = weights.new_zeros(len(weights), largest + 1 if count is None else count)
    return empty.scatter_add(1, joints.long(), weights)
