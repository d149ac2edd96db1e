"""A skeleton of hinges: angles become the joint matrices of linear blend skinning."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError


@dataclass(frozen=True, eq=False)
class Rig:
    """Joints that turn about fixed axes of the rest pose, each carrying those that name it as their parent.

    `weights [V, J]`: how much each vertex follows each joint; rows sum to 1. `pivots [J, 3]`: a point of each axis;
    `axes [J, 3]`: unit vectors; `parents`: the number of the joint that each hangs from, -1 for none; parents first.

    Raises InputError if the numbers of joints differ, or a joint comes before its parent.
    """

    weights: Float[Tensor, "V J"]
    pivots: Float[Tensor, "pivots 3"]
    axes: Float[Tensor, "axes 3"]
    parents: tuple[int, ...]

    def __post_init__(self) -> None:
        joints = {self.weights.shape[1], len(self.pivots), len(self.axes), len(self.parents)}
        if len(joints) != 1:
            raise InputError(f"rig has {sorted(joints)} joints in weights, pivots, axes and parents: give one number")
        if not all(-1 <= parent < joint for joint, parent in enumerate(self.parents)):
            raise InputError(f"rig has parents {self.parents}: each joint must come after its parent")

    def pose(self, angles: Float[Tensor, "*B J"]) -> Float[Tensor, "*B J 4 4"]:
        """The matrices that move the rest pose with each joint; angles in radians, zero is the rest pose.

        Gradients flow to the angles.
        """
        local = _about(self.axes.to(angles), self.pivots.to(angles), angles)
        world: list[Tensor] = []
        for joint, parent in enumerate(self.parents):
            own = local[..., joint, :, :]
            world.append(own if parent < 0 else world[parent] @ own)
        return torch.stack(world, -3)


def _about(
    axes: Float[Tensor, "J 3"], pivots: Float[Tensor, "J 3"], angles: Float[Tensor, "*B J"]
) -> Float[Tensor, "*B J 4 4"]:
    """Turns about lines through the pivots (Rodrigues)."""
    zero = torch.zeros_like(axes[:, 0])
    x, y, z = axes.unbind(-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    sine, versine = angles.sin()[..., None, None], 2 * (angles / 2).sin().square()[..., None, None]
    turn = torch.eye(3).to(axes) + sine * cross + versine * (cross @ cross)
    shift = pivots - (turn @ pivots[:, :, None])[..., 0]
    top = torch.cat([turn, shift[..., None]], -1)
    last = torch.tensor([0.0, 0.0, 0.0, 1.0]).to(axes).expand(*top.shape[:-2], 1, 4)
    return torch.cat([top, last], -2)
