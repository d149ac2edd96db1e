"""Stills of a bake under an environment, and series of them in which the camera or the light goes around."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import atomic
from torchprt.preview.camera import Camera
from torchprt.preview.environment import Environment, seen_along
from torchprt.preview.ground import opacity
from torchprt.preview.orbit import Orbit
from torchprt.preview.picture import BACKGROUND, Still
from torchprt.preview.relight import Relight
from torchprt.sh import rotate, yaw_pitch_roll
from torchprt.shade import Shader
from torchprt.shade.display import ToneMap
from torchprt.transfer import Transfer


class Studio:
    """Pictures of `transfer` by its `shader`, seen from `camera`, in `environment`, without a display.

    `rotation` turns the environment, which is shown behind the model if `backdrop`. Glossy transfer is shaded for the
    eye of the camera. `exposure` in stops. A ground fades toward its edge unless `with_ground`.
    Raises InputError as `Still` and the shader.
    """

    def __init__(
        self,
        transfer: Transfer,
        shader: Shader,
        environment: Environment,
        *,
        size: tuple[int, int] = (800, 600),
        exposure: float | int = 0.0,
        tone: ToneMap = "filmic",
        backdrop: bool = False,
        samples: int = 2,
        with_ground: bool = False,
    ):
        if backdrop and environment.image is None:
            raise InputError(f"{environment.name} has no image to show behind the model: give an environment image")
        self.transfer = transfer
        self.environment = environment
        self.size = size
        self.exposure = exposure
        self.tone: ToneMap = tone
        self.backdrop = backdrop
        self.samples = samples
        self._relight = Relight(shader)
        self._still: Still | None = None
        self._opacity = None if with_ground else opacity(transfer.receivers)

    def picture(self, camera: Camera, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "H W 3"]:
        """One picture as sRGB in [0, 1]. Rays are traced only if the camera is another than before."""
        if self._still is None or self._still.camera != camera:
            self._still = Still(
                self.transfer.positions,
                self.transfer.faces,
                size=self.size,
                camera=camera,
                samples=self.samples,
                opacity=self._opacity,
            )
        lit = self._relight(rotate(self.environment.light, rotation), torch.tensor(camera.eye, dtype=torch.float64))
        behind: float | Tensor = BACKGROUND
        if self.backdrop and self.environment.image is not None:
            behind = seen_along(self.environment.image, self._still.directions(), rotation)
        return self._still.picture(lit.float(), exposure=self.exposure, tone=self.tone, background=behind)

    def turntable(self, count: int, orbit: Orbit, rotation: Float[Tensor, "3 3"]) -> Iterator[Float[Tensor, "H W 3"]]:
        """`count` pictures in which the camera goes once around +y."""
        for number in range(_positive(count)):
            yield self.picture(orbit.turned(-2 * math.pi * number / count, 0.0).camera(), rotation)

    def light_turntable(
        self, count: int, camera: Camera, rotation: Float[Tensor, "3 3"]
    ) -> Iterator[Float[Tensor, "H W 3"]]:
        """`count` pictures in which the environment, already turned by `rotation`, goes once around +y."""
        for number in range(_positive(count)):
            yaw = yaw_pitch_roll(torch.tensor([360.0 * number / count, 0.0, 0.0], dtype=rotation.dtype))
            yield self.picture(camera, yaw @ rotation)


def strip(pictures: Sequence[Float[Tensor, "H W 3"]], columns: int | None = None) -> Float[Tensor, "I J 3"]:
    """The pictures side by side in rows of `columns`, about as many as there are rows if omitted; black where none is.

    Raises InputError without pictures or if their sizes differ.
    """
    if not pictures or len({tuple(picture.shape) for picture in pictures}) != 1:
        raise InputError("a strip is of one picture or more, all of one size")
    columns = columns or math.ceil(len(pictures) ** 0.5)
    rows = -(-len(pictures) // columns)
    cells = [*pictures, *[torch.zeros_like(pictures[0])] * (rows * columns - len(pictures))]
    return torch.cat([torch.cat(cells[row * columns : (row + 1) * columns], 1) for row in range(rows)])


def save_gif(
    pictures: Sequence[Float[Tensor, "H W 3"]], path: str | os.PathLike[str], rate: float | int = 15.0
) -> None:
    """Writes sRGB pictures in [0, 1] as an animation that repeats, `rate` a second.

    Raises InputError without pictures, unless 0 < rate <= 50 (viewers slow down what is faster), or if `path` cannot be
    written.
    """
    from PIL import Image

    if not pictures or not 0 < rate <= 50:
        raise InputError(f"{len(pictures)} pictures at {rate} a second: give one or more at a rate up to 50")
    shown = []
    for picture in pictures:
        values = (picture.detach().cpu().clamp(0, 1) * 255).round().to(torch.uint8).numpy()
        shown.append(Image.fromarray(np.ascontiguousarray(values)).quantize(255, dither=Image.Dither.FLOYDSTEINBERG))
    first, *others = shown
    with atomic(Path(path)) as temporary:
        # In hundredths of a second, which is what the format stores.
        duration = 10 * round(100 / rate)
        first.save(temporary, format="GIF", save_all=True, append_images=others, duration=duration, loop=0)


def _positive(count: int) -> int:
    if count < 1:
        raise InputError(f"a turntable of {count} pictures: give one or more")
    return count
