"""Where transfer is recorded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.transport.directions import frames

# Rays handed to Embree at a time, so that they and their answers stay in a core's cache.
BLOCK = 1 << 16


@dataclass
class Receivers:
    """Where transfer is recorded: points and unit normals in the world, float64, and ray `origins` in the frame of
    the tracer, float32: one a receiver, or S, [V, S, 3], that its rays take in turn. A receiver with a zero normal has
    zero transfer.

    `tangents`: unit and orthogonal to the normals, zero where any frame will do; None if that is everywhere."""

    points: Float[Tensor, "V 3"]
    normals: Float[Tensor, "V 3"]
    origins: Float[Tensor, "V *S 3"]
    tangents: Float[Tensor, "V 3"] | None = None

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, rows: slice | Tensor) -> Receivers:
        tangents = None if self.tangents is None else self.tangents[rows]
        return Receivers(self.points[rows], self.normals[rows], self.origins[rows], tangents)

    def blocks(self, rays: int, most: int = BLOCK) -> Iterator[slice]:
        """Slices of at most so many rays (one receiver at least)."""
        step = max(1, most // rays)
        return (slice(start, min(start + step, len(self))) for start in range(0, len(self), step))

    def frames(self) -> Float[Tensor, "V 3 3"]:
        """Local frames, rows tangent, bitangent and normal, float32."""
        turned = frames(self.normals)
        if self.tangents is not None:
            given = tangent_frames(self.normals, self.tangents)
            turned = torch.where((self.tangents != 0).any(-1)[:, None, None], given, turned)
        return turned.to(torch.float32)


def tangent_frames(normals: Float[Tensor, "V 3"], tangents: Float[Tensor, "V 3"]) -> Float[Tensor, "V 3 3"]:
    """Frames whose rows are tangent, normal x tangent, normal; where the normal is zero those of `frames`."""
    given = torch.stack([tangents, torch.linalg.cross(normals, tangents), normals], -2)
    return torch.where((normals == 0).all(-1)[:, None, None], frames(normals), given)
