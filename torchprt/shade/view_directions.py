"""Where the eye is, seen from every receiver in its local frame."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.sh import check_rotation, to_horizon
from torchprt.sh.basis import values_are_at_hand
from torchprt.sh.precision import widened


def local_frames(
    normals: Float[Tensor, "G 3"], tangents: Float[Tensor, "G 3"]
) -> tuple[Float[Tensor, "G 3 3"], Tensor]:
    """Frames in float64, rows tangent, normal x tangent, normal, and which receivers have one.

    A receiver whose normal is zero has none; its frame is the identity.
    Raises InputError if a tangent is not of unit length and orthogonal to its normal within 1e-4.
    """
    normals, tangents = normals.double(), tangents.double()
    has_frame = normals.abs().amax(-1) > 0
    frames = torch.stack([tangents, torch.linalg.cross(normals, tangents, dim=-1), normals], -2)
    frames = torch.where(has_frame[:, None, None], frames, torch.eye(3, dtype=frames.dtype, device=frames.device))
    check_rotation(frames, "local frame (tangent, normal x tangent, normal) of the transfer")
    return frames, has_frame


def toward_eye(
    points: Float[Tensor, "3 *P G"], eye: Float[Tensor, "*B 3"] | None, view: Float[Tensor, "*B 3"] | None
) -> Float[Tensor, "3 ..."]:
    """World directions toward the eye, of any length, `[3, *B, G]`; G = 1 for `view`, one direction for all receivers.

    Batches of `points`, one for each pose, and of eyes broadcast.
    Narrow ones are used in float32.
    Raises InputError unless exactly one is given, it has three components and, where values may be looked at, they
    are finite and `view` is not zero.
    """
    if (eye is None) == (view is None):
        fault = "neither is given" if eye is None else "both are given"
        raise InputError(f"eye and view: {fault}; give one, eye (a point) or view (a direction toward the eye)")
    name, value = ("eye", eye) if eye is not None else ("view", view)
    assert value is not None
    if value.ndim == 0 or value.shape[-1] != 3:
        raise InputError(f"{name} has shape {list(value.shape)}: its last dimension must be x, y, z")
    if values_are_at_hand(value):
        if not bool(value.isfinite().all()):
            raise InputError(f"{name} holds NaN or infinity: give finite numbers")
        if view is not None and not bool(value.abs().amax(-1).gt(0).all()):
            raise InputError("view is a zero vector: give a direction from the surface toward the eye")
    lanes = widened(value).movedim(-1, 0).unsqueeze(-1)
    if eye is not None:
        batch = max(lanes.ndim, points.ndim) - 2
        lanes, points = (part.reshape(3, *(1,) * (batch - part.ndim + 2), *part.shape[1:]) for part in (lanes, points))
        return lanes - points
    # Here already, so that a view of any length has a length below.
    return lanes / lanes.abs().amax(0).detach()


def local_views(toward: Float[Tensor, "3 *B #G"], frames: Float[Tensor, "3 3 G"]) -> Float[Tensor, "*B G 3"]:
    """Unit directions `toward` the eye in the local frames; memory has components first.

    An eye below the tangent plane of a receiver is moved to the horizon: the silhouette of a smoothly shaded mesh has
    such receivers, and black ones would draw a rim. An eye at the receiver (no coordinate farther than the square root
    of the smallest number, 1e-19 in float32) or straight below it looks along the normal.
    """
    # Divided by the largest component first: the far and the near must not leave the range.
    largest = toward.detach().abs().amax(0)
    at_receiver = largest <= torch.finfo(toward.dtype).tiny ** 0.5
    scaled = toward / torch.where(at_receiver, torch.inf, largest)
    wide = frames.reshape(3, 3, *(1,) * (toward.ndim - 2), frames.shape[-1])
    return to_horizon((wide * scaled).sum(1).movedim(0, -1))
