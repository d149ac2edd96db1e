"""Direct diffuse transfer: closed form without shadows, Embree with them."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.sh import basis, clamped_cosine
from torchprt.sh.euler import turn_by_euler
from torchprt.trace import Tracer
from torchprt.transport.receivers import Receivers
from torchprt.transport.through_volume import ThroughVolume


def unshadowed(normals: Float[Tensor, "V 3"], order: int) -> Float[Tensor, "N V"]:
    """Transfer vectors `(1/pi) int H_N y_i` in closed form, float32; zero where the normal is zero.

    Source: Sloan, Kautz and Snyder 2002, section 4.1 (T_DU); Ramamoorthi and Hanrahan 2001 for the coefficients.
    """
    factors = clamped_cosine(order, dtype=torch.float64) / math.pi
    degree = torch.repeat_interleave(factors, torch.arange(1, 2 * order, 2))
    vectors = degree[:, None] * basis(normals.to(torch.float64), order).movedim(-1, 0)
    return torch.where(normals.abs().sum(-1) > 0, vectors, 0).to(torch.float32)


def cosine_weights(directions: Float[Tensor, "D 3"]) -> Float[Tensor, "D"]:
    """`(1/pi) H(s) ds` of every hemisphere direction; they sum to 1 up to the error of the set."""
    return 2 * directions[:, 2] / len(directions)


def projection(directions: Float[Tensor, "D 3"], order: int) -> Float[Tensor, "N D"]:
    """The matrix that takes the visibility of a receiver to its transfer vector in the local frame, float32.

    The columns share a small correction by which a receiver that sees the whole hemisphere gets the closed form of
    `unshadowed` exactly; one that sees nothing gets zero exactly.
    """
    weighted = basis(directions, order).movedim(-1, 0) * cosine_weights(directions)
    pole = torch.tensor([0.0, 0.0, 1.0], dtype=directions.dtype)
    exact = torch.repeat_interleave(clamped_cosine(order) / math.pi, torch.arange(1, 2 * order, 2)) * basis(pole, order)
    correction = (exact - weighted.sum(-1)) / len(directions)
    return (weighted + correction[:, None]).to(torch.float32)


def shadowed(
    tracer: Tracer,
    receivers: Receivers,
    directions: Float[Tensor, "D 3"],
    project: Float[Tensor, "N D"],
    volume: ThroughVolume | None = None,
) -> Float[Tensor, "N v"]:
    """Transfer vectors `(1/pi) int H_N V y_i` of a chunk of receivers, world frame, float32; V is what is left of the
    light of visible directions if it comes through a volume.

    A pure function of its arguments: the same bits wherever and beside whatever it runs.
    Source: Sloan, Kautz and Snyder 2002, section 5, shadow pass.
    """
    turned = receivers.frames()
    rays = directions.to(torch.float32)
    local = torch.empty(len(project), len(receivers), dtype=torch.float32)
    for rows in receivers.blocks(len(rays), tracer.at_once):
        visible = tracer.visibility(receivers.origins[rows], turned[rows], rays)
        if volume is not None:
            visible *= volume.left(tracer, receivers.origins[rows], turned[rows], rays, visible != 0)
        local[:, rows] = project @ visible.T
    return to_world(local, turned, receivers.normals)


def to_world(
    local: Float[Tensor, "N v"], turned: Float[Tensor, "v 3 3"], normals: Float[Tensor, "v 3"]
) -> Float[Tensor, "N v"]:
    """Transfer vectors from local frames to the world; zero where the normal is zero."""
    # Frames are rotations: nothing to check.
    world = turn_by_euler(local.T[:, :, None], turned.mT)[..., 0]
    return torch.where(normals.abs().sum(-1, keepdim=True) > 0, world, 0).T
