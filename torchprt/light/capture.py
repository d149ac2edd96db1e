"""The light about sample points from whoever knows the radiance there: one cube map a point, projected in one batch."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.light.probes import spacing_of
from torchprt.sh import cube_directions, project_cube
from torchprt.sh.basis import values_are_at_hand

Radiance: TypeAlias = Callable[[Tensor, Tensor], Tensor]
"""Radiance `[P, D, 3]` that arrives at points `[P, 3]` along unit directions `[D, 3]`, which point away from them."""

# Of the spacing of the points: how far the cube maps of differences lie off them.
STEP = 0.1
# Texels that are captured at once.
PIECE = 1 << 22


def capture(
    points: Float[Tensor, "S 3"],
    order: int,
    radiance: Radiance,
    *,
    size: int = 64,
    gradients: bool = False,
    step: float | None = None,
) -> Float[Tensor, "K N 3"]:
    """Lights at sample points, K = S, from cube maps of 6 x `size` x `size` texels about each of them.

    `radiance(points [P, 3], directions [D, 3]) -> [P, D, 3]` is asked for all texels of some points at a time; what is
    lit must not be seen by it. `transport.lamps_seen` makes one of lamps and blockers; a renderer, or a network, is as
    good. With `gradients` K = 4 S: behind the light of a point its derivatives along x, y and z, as differences of the
    cube maps half a `step` to either side, so there are seven a point; `step` is a tenth of the spacing of the points
    if omitted. Let `size` be large then: the noise of edges, which are a texel wide, is divided by the step.
    `light.incident` has exact derivatives where nothing is in the way.

    The result has the dtype of `points`; gradients flow through what `radiance` gives.
    Raises InputError if there is no point, `size` is below 1, `step` is not above 0 or not given for one point, or what
    `radiance` gives has another shape, is negative or not finite.
    Source: Sloan, Kautz and Snyder 2002, section 6.2.
    """
    if len(points) == 0 or size < 1:
        raise InputError(f"{len(points)} points and cube maps of size {size}: give one or more of both")
    if gradients and step is None:
        if len(points) == 1:
            raise InputError("gradients of one point are differences over a step that follows from nothing: give step")
        step = STEP * spacing_of(points)
    if gradients and not (step is not None and step > 0):
        raise InputError(f"step is {step}: give a length above 0")
    directions = cube_directions(size).reshape(-1, 3).to(points)
    places = points
    if step is not None and gradients:
        axes = torch.cat([torch.zeros_like(points[:1].expand(1, 3)), *_sides(points, step)])
        places = (points[:, None] + axes).flatten(0, 1)
    blocks = places.split(max(1, PIECE // len(directions)))
    lights = torch.cat([_projected(radiance, block, directions, order, size) for block in blocks])
    if not gradients:
        return lights
    assert step is not None
    each = lights.unflatten(0, (len(points), 7))
    slopes = (each[:, 1:4] - each[:, 4:]) / step
    return torch.cat([each[:, :1], slopes], 1).flatten(0, 1)


def _sides(points: Tensor, step: float) -> list[Tensor]:
    half = step / 2 * torch.eye(3, dtype=points.dtype, device=points.device)
    return [half, -half]


def _projected(radiance: Radiance, points: Tensor, directions: Tensor, order: int, size: int) -> Tensor:
    seen = radiance(points, directions)
    wanted = (len(points), len(directions), 3)
    if seen.shape != wanted:
        raise InputError(f"the radiance that is captured has shape {list(seen.shape)}: it must be {list(wanted)}")
    if values_are_at_hand(seen) and not bool((seen.detach().isfinite() & (seen.detach() >= 0)).all()):
        raise InputError("the radiance that is captured holds negative values, NaN or infinity: give finite radiance")
    return project_cube(seen.reshape(len(points), 6, size, size, 3), order).to(points.dtype)
