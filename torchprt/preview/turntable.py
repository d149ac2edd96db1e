"""Stills of a bake under an environment, and series of them in which the camera or the light goes around."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.files import write
from torchprt.preview.camera import Camera
from torchprt.preview.encode import encoded, image_of
from torchprt.preview.environment import Environment, automatic_exposure, for_pixels, photograph, seen_along
from torchprt.preview.orbit import Orbit
from torchprt.preview.picture import SAMPLES, Still
from torchprt.preview.relight import Relight
from torchprt.sh import rotate, yaw_pitch_roll
from torchprt.shade import Shader, tone_mapped
from torchprt.shade.display import TONE, ToneMap, linear
from torchprt.transfer import Transfer

Background = Literal["plain", "environment", "transparent"] | tuple[float, float, float]


class Studio:
    """Pictures of `transfer` by its `shader`, seen from `camera`, in `environment`, without a display.

    `rotation` turns the environment. Glossy transfer is shaded for the eye of the camera. `exposure` in stops, that of
    `automatic_exposure` if omitted. `background`: a plain grey one, the environment, nothing (pictures then have a
    fourth channel, their opacity), or a colour in sRGB. A ground fades out toward its rim.
    `colours`: sRGB of the vertices, to be shown as they are in place of their radiance. `relight`: what gives their
    radiance under the turned light of the environment toward an eye, in place of the shader.
    Raises InputError as `Still` and the shader.
    """

    def __init__(
        self,
        transfer: Transfer,
        shader: Shader,
        environment: Environment,
        *,
        size: tuple[int, int] = (800, 600),
        exposure: float | int | None = None,
        tone: ToneMap = TONE,
        background: Background = "plain",
        samples: int = SAMPLES,
        colours: Float[Tensor, "V 3"] | None = None,
        relight: Callable[[Tensor, Tensor], Tensor] | None = None,
    ):
        if background == "environment" and environment.image is None:
            raise InputError(f"{environment.name} has no image to show behind the model: give an environment image")
        self.transfer = transfer
        self.environment = environment
        self.size = size
        self.exposure = automatic_exposure(environment.light) if exposure is None else float(exposure)
        self.tone: ToneMap = tone
        self.background: Background = background
        self.samples = samples
        self._colours = None if colours is None else linear(colours.float())
        self._relight = Relight(shader) if relight is None else relight
        self._still: Still | None = None
        self._panorama: tuple[float, Tensor] | None = None

    def picture(
        self,
        camera: Camera,
        rotation: Float[Tensor, "3 3"],
        radiance: Float[Tensor, "V 3"] | None = None,
    ) -> Float[Tensor, "H W C"]:
        """One picture as sRGB in [0, 1]. Rays are traced only if the camera is another than before.

        `radiance` of the vertices takes the place of what the shader gives.
        """
        still = self._look(camera)
        exposure, tone = self.exposure, self.tone
        if self._colours is not None:
            radiance, exposure, tone = self._colours, 0.0, "none"
        elif radiance is None:
            still, radiance = self.shaded(camera, rotate(self.environment.light, rotation))
        else:
            still, radiance = self.given(camera, radiance)
        sky = self._surroundings(camera, still.sky, rotation)
        if self.background == "transparent":
            return still.cutout(radiance.float(), exposure=exposure, tone=tone, sky=sky)
        behind = self._behind(camera, rotation)
        return still.picture(radiance.float(), exposure=exposure, tone=tone, background=behind, sky=sky)

    def shaded(self, camera: Camera, light: Float[Tensor, "N 3"]) -> tuple[Still, Float[Tensor, "V 3"]]:
        """What a camera sees, and its radiance under a light: a `Still` and what its `radiance` makes pixels of."""
        return self._look(camera), self._relight(light, torch.tensor(camera.eye, dtype=torch.float64))

    def given(self, camera: Camera, radiance: Float[Tensor, "V 3"]) -> tuple[Still, Float[Tensor, "V 3"]]:
        """As `shaded`, of radiance that is known."""
        return self._look(camera), radiance

    def _look(self, camera: Camera) -> Still:
        if self._still is None or self._still.camera != camera:
            place = self.transfer.receivers
            if not place.on_surface:
                raise InputError("a volume is no mesh to make a still of: use preview.VolumeStudio, or studio_of")
            self._still = Still.of(place, size=self.size, camera=camera, samples=self.samples)
        return self._still

    def _behind(self, camera: Camera, rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "H W 3"] | None:
        """Linear RGB behind the model as it is shown; None for the plain background."""
        if isinstance(self.background, tuple):
            return linear(torch.tensor(self.background)).expand(self.size[1], self.size[0], 3)
        if self.background != "environment" or self.environment.image is None:
            return None
        seen = seen_along(self._shown(camera), camera.directions(*self.size), rotation)
        return tone_mapped(seen.float(), exposure=self.exposure, tone=self.tone)

    def _surroundings(
        self, camera: Camera, directions: Float[Tensor, "E 3"], rotation: Float[Tensor, "3 3"]
    ) -> Float[Tensor, "E 3"] | None:
        """Radiance of the environment that mirrors show; None if they show none."""
        if not len(directions):
            return None
        return seen_along(self._shown(camera), directions, rotation).float()

    def _shown(self, camera: Camera) -> Float[Tensor, "H W 3"]:
        """The environment for the pixels of a camera: its image, or what its light stands for."""
        # Once for all pictures of one angle of view.
        if self._panorama is None or self._panorama[0] != camera.field:
            texel = math.radians(camera.field) / self.size[1]
            image = self.environment.image
            self._panorama = (
                camera.field,
                for_pixels(photograph(self.environment.light) if image is None else image, texel),
            )
        return self._panorama[1]

    def turntable(self, count: int, orbit: Orbit, rotation: Float[Tensor, "3 3"]) -> Iterator[Float[Tensor, "H W C"]]:
        """`count` pictures in which the camera goes once around +y."""
        for number in range(_positive(count)):
            yield self.picture(orbit.turned(-2 * math.pi * number / count, 0.0).camera(), rotation)

    def light_turntable(
        self, count: int, camera: Camera, rotation: Float[Tensor, "3 3"]
    ) -> Iterator[Float[Tensor, "H W C"]]:
        """`count` pictures in which the environment, already turned by `rotation`, goes once around +y."""
        for number in range(_positive(count)):
            yaw = yaw_pitch_roll(torch.tensor([360.0 * number / count, 0.0, 0.0], dtype=rotation.dtype))
            yield self.picture(camera, yaw @ rotation)


def strip(pictures: Sequence[Float[Tensor, "H W C"]], columns: int | None = None) -> Float[Tensor, "I J C"]:
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
    first, *others = (image_of(each).quantize(255, dither=Image.Dither.FLOYDSTEINBERG) for each in pictures)
    # In hundredths of a second, which is what the format stores.
    duration = 10 * round(100 / rate)
    write(path, encoded(first, format="GIF", save_all=True, append_images=others, duration=duration, loop=0))


def _positive(count: int) -> int:
    if count < 1:
        raise InputError(f"a turntable of {count} pictures: give one or more")
    return count
