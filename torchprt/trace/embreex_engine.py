"""The engine that always works: embreex, which hands rays to Embree one at a time."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float, Float32, Int32
from torch import Tensor

from torchprt.trace.hits import Hits
from torchprt.trace.rays import in_the_world


class Embreex:
    """An `Engine`: Embree in robust mode, by way of embreex."""

    # Rays and their answers stay in a core's cache.
    at_once = 1 << 16

    def __init__(self, vertices: Float32[np.ndarray, "V 3"], faces: Int32[np.ndarray, "F 3"]) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene = EmbreeScene(robust=True)
        self._mesh = TriangleMesh(self._scene, vertices, faces)
        # The first query builds the tree; it must not race with others.
        zero = np.zeros((1, 3), np.float32)
        self._scene.run(zero, zero + np.float32(1), query="OCCLUDED")

    def visibility(
        self, origins: Float[Tensor, "v *S 3"], frames: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
    ) -> Float32[Tensor, "v D"]:
        """As `Engine.visibility`."""
        start, rays = in_the_world(origins, frames, directions)
        blocked = self._scene.run(start, rays, query="OCCLUDED")
        # Embree's own numbers are -1 for a ray that escapes, and 0.
        return torch.from_numpy(blocked).view(len(origins), len(directions)).to(torch.float32).neg_()

    def hits(
        self, origins: Float[Tensor, "v *S 3"], frames: Float[Tensor, "v 3 3"], directions: Float[Tensor, "D 3"]
    ) -> Hits:
        """As `Engine.hits`."""
        found = self.nearest(*in_the_world(origins, frames, directions))
        return Hits(*(part.view(len(origins), len(directions)) for part in vars(found).values()))

    def nearest(self, origins: Float32[np.ndarray, "E 3"], directions: Float32[np.ndarray, "E 3"]) -> Hits:
        """As `Engine.nearest`."""
        found = self._scene.run(origins, directions, output=1)
        facing = np.einsum("rk,rk->r", found["Ng"], directions) < 0
        return Hits(*(torch.from_numpy(part) for part in (found["primID"], found["u"], found["v"], facing)))
