"""A box around an object that encloses the shadow that it casts."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.trace import Tracer
from torchprt.transport.directions import frames, sphere

SHARE = 0.02
"""Of the irradiance of a receiver that faces up under a white light: what an object may take beyond its box."""
# Points a side of each face, their rays, and how far a face moves at a time and at most, in extents of the object.
_SIDE, _RAYS, _STEP, _MOST = 9, 256, 0.1, 16.0


def enclosing_box(
    tracer: Tracer, low: Float[Tensor, "3"], high: Float[Tensor, "3"], share: float = SHARE
) -> tuple[Float[Tensor, "3"], Float[Tensor, "3"], float]:
    """The lowest and highest corner of the box, and the largest share that was found on its border.

    It starts as the bounds `low` to `high` of the object. Those of its faces are moved outward, the four upright ones
    and the one below, until from no point of 9 x 9 on them the object takes more than `share` of the irradiance of a
    receiver that faces up (+y) under a white light, which is `(1 / pi) int (1 - V) max(s_y, 0) ds`, measured with 256
    rays toward it. It ends a tenth of the object above it: what faces up there has its light.

    A tall object under which nothing is hidden still gets a tenth of its extent on every side.
    """
    extent = float((high - low).max())
    middle, radius = (low + high) / 2, float((high - low).norm()) / 2
    margin = _STEP * extent
    low, high = low - margin, high + margin
    # The face below, and of x and z the two each: which axis, and whether it is the higher one.
    faces = [(1, False), (0, False), (0, True), (2, False), (2, True)]
    largest = 0.0
    for _ in range(int(_MOST / _STEP)):
        found = [_taken(tracer, _face(low, high, axis, upper), middle, radius) for axis, upper in faces]
        largest = max(found)
        if largest <= share:
            break
        for (axis, upper), taken in zip(faces, found, strict=True):
            if taken > share:
                (high if upper else low)[axis] += margin if upper else -margin
    return low, high, largest


def _face(low: Tensor, high: Tensor, axis: int, upper: bool) -> Float[Tensor, "p 3"]:
    """Points on a face of the box."""
    steps = torch.linspace(0, 1, _SIDE, dtype=torch.float64)
    u, v = torch.meshgrid(steps, steps, indexing="ij")
    share = torch.stack([u.flatten(), v.flatten()], -1)
    others = [each for each in range(3) if each != axis]
    points = torch.empty(len(share), 3, dtype=torch.float64)
    points[:, axis] = high[axis] if upper else low[axis]
    points[:, others] = low[others] + share * (high - low)[others]
    return points


def _taken(tracer: Tracer, points: Float[Tensor, "p 3"], middle: Float[Tensor, "3"], radius: float) -> float:
    """The largest share of the irradiance of receivers that face up at these points; `middle` and `radius` of a sphere
    that holds the object. Rays go where it may be: over a cap around the direction to its middle, one size for all."""
    toward = middle - points
    nearest = float(toward.norm(dim=-1).min())
    cosine = -1.0 if nearest <= radius else math.sqrt(1 - (radius / nearest) ** 2)
    directions = sphere(_RAYS)
    z = 1 - (1 - directions[:, 2]) * (1 - cosine) / 2
    across = torch.nn.functional.normalize(directions[:, :2], dim=-1) * (1 - z * z).clamp(min=0).sqrt()[:, None]
    cap = torch.cat([across, z[:, None]], -1)
    turned = frames(torch.nn.functional.normalize(toward, dim=-1))
    up = (cap @ turned)[..., 1].clamp(min=0)
    origins = tracer.local(points).to(torch.float32)
    blocked = 1 - tracer.visibility(origins, turned.to(torch.float32), cap.to(torch.float32)).double()
    return float((blocked * up).sum(-1).max()) * 2 * (1 - cosine) / len(cap)
