"""Pictures of a volume, alone or before and around a surface."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.preview.camera import Camera
from torchprt.preview.environment import Environment
from torchprt.preview.picture import Still
from torchprt.preview.relight import Relight
from torchprt.preview.turntable import Studio
from torchprt.shade import Composite, Reading, Shader, shader
from torchprt.transfer import Transfer


class VolumeStudio(Studio):
    """A studio of a `volume`, whose source radiance is composited along every ray of every pixel.

    `surface`: a transfer that stands in it or behind it, and `surface_shader` what shades it: rays end at it. What the
    one does to the light of the other is in their bakes. `reading`, `steps`: as for `shade.Composite`. All other
    `options` are those of a `Studio`.
    Raises InputError as these, if `volume` is of no volume, the orders of their lights differ, or the surface has
    mirrors.
    Source: Sloan, Kautz and Snyder 2002, section 7.
    """

    def __init__(
        self,
        volume: Transfer,
        environment: Environment,
        *,
        surface: Transfer | None = None,
        surface_shader: Shader | None = None,
        reading: Reading = "trilinear",
        steps: int | None = None,
        **options: Any,
    ):
        self.composite = Composite(volume.receivers.as_cells(), reading=reading, samples=steps)
        cells = shader(volume, dtype=torch.float32)
        self.alone = surface is None
        if surface is None:
            super().__init__(volume, cells, environment, **options)
        else:
            if surface.order != volume.order:
                raise InputError(
                    f"the volume answers to lights of order {volume.order}, the surface of order {surface.order}: bake "
                    "both with one order"
                )
            if surface.receivers.mirrors is not None:
                raise InputError("a volume is not seen in mirrors: leave it out, or bake the scene without them")
            super().__init__(surface, surface_shader or shader(surface), environment, **options)
        if self._colours is not None:
            raise InputError("a volume has no vertices to be shown in colours: leave it or them out")
        # Of the volume alone it is that of the studio, which may be replaced.
        self._cells = self._relight if surface is None else Relight(cells)
        self._far: tuple[Camera, Tensor] | None = None

    def shaded(self, camera: Camera, light: Float[Tensor, "N 3"]) -> tuple[Still, Float[Tensor, "V 3"]]:
        source = self._cells(light.float(), torch.tensor(camera.eye, dtype=torch.float64))
        if self.alone:
            return self.given(camera, source)
        still, radiance = super().shaded(camera, light)
        return self._veiled(still, source), radiance

    def given(self, camera: Camera, radiance: Float[Tensor, "V 3"]) -> tuple[Still, Float[Tensor, "none 3"]]:
        """A picture of the volume alone whose cells have this source radiance."""
        if not self.alone:
            raise InputError("radiance is given for a surface in a volume, whose own is not: leave it out")
        return self._veiled(self._look(camera), radiance), radiance.new_zeros(0, 3)

    def _veiled(self, still: Still, source: Tensor) -> Still:
        """What is seen through the volume."""
        rays = still.directions()
        far = None
        if not self.alone:
            if self._far is None or self._far[0] != still.camera:
                place = self.transfer.receivers
                self._far = still.camera, still.distances(*place.surface[::2])
            far = self._far[1].flatten()
        eye = torch.tensor(still.camera.eye, dtype=torch.float64)
        with torch.no_grad():
            radiance, through = self.composite(source.float(), eye[None], rays.flatten(0, 2), far)
        # An eye sees no negative radiance, which ringing leaves in deep shadow.
        return still.veiled(radiance.clamp(min=0).view(*rays.shape), through.view(rays.shape[:3]))

    def _look(self, camera: Camera) -> Still:
        if not self.alone:
            return super()._look(camera)
        if self._still is None or self._still.camera != camera:
            self._still = Still.empty(size=self.size, camera=camera, samples=self.samples)
        return self._still


def studio_of(
    transfer: Transfer,
    shaded: Shader,
    environment: Environment,
    *,
    volume: Transfer | None = None,
    **options: Any,
) -> Studio:
    """A studio of `transfer`, be it of a surface or of a volume, and with another `volume` before and around it."""
    if not transfer.receivers.on_surface:
        if volume is not None:
            raise InputError("a volume is given, but what is shown is a volume itself: bake both as one")
        return VolumeStudio(transfer, environment, **options)
    if volume is not None:
        return VolumeStudio(volume, environment, surface=transfer, surface_shader=shaded, **options)
    return Studio(transfer, shaded, environment, **options)
