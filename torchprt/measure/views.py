"""Pictures of radiance from a few cameras, and what a person would see of the difference."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.measure.error import psnr
from torchprt.preview import Camera, Still, automatic_exposure, frame, subject
from torchprt.transfer import Receivers

SIZE = (480, 360)
VIEW = (0.45, 0.35, 1.0)
"""From the model toward the camera, where no eye is given: as in every picture."""
# Decibels of pictures that are equal.
MOST = 100.0


class Views:
    """The model of `receivers` seen from `eyes [E, 3]`, or from the usual side; exposures are those of the lights.

    `size` in pixels, (480, 360) if omitted.

    Raises InputError as `Still` and `frame`, and if flip-evaluator is not installed.
    """

    def __init__(
        self,
        receivers: Receivers,
        lights: Sequence[Float[Tensor, "N 3"]],
        eyes: Float[Tensor, "E 3"] | None = None,
        size: tuple[int, int] | None = None,
    ):
        check_flip()
        size = size or SIZE
        self.cameras = cameras(receivers, eyes, size)
        self._stills = [
            Still.of(receivers, size=size, camera=camera, samples=4, mirrors=False) for camera in self.cameras
        ]
        self._exposures = [automatic_exposure(light) for light in lights]
        # What shows the model: the background is never wrong, nor is the black of back faces.
        white = torch.ones(receivers.count, 3)
        self._seen = [still.radiance(white)[..., 0] > 0 for still in self._stills]
        for camera, seen in zip(self.cameras, self._seen, strict=True):
            if not bool(seen.any()):
                raise InputError(_blind(camera.eye))

    @property
    def eyes(self) -> Float[Tensor, "E 3"]:
        """Where the cameras are, float64."""
        return torch.tensor([camera.eye for camera in self.cameras], dtype=torch.float64)

    def picture(self, radiance: Float[Tensor, "V 3"], light: int = 0, eye: int = 0) -> Float[Tensor, "H W 3"]:
        """sRGB in [0, 1]."""
        return self._stills[eye].picture(radiance.float(), exposure=self._exposures[light]).float().clamp(0, 1)

    def painted(self, colours: Float[Tensor, "V 3"], eye: int = 0) -> Float[Tensor, "H W 3"]:
        """The model in these colours, sRGB, on white."""
        return self._stills[eye].radiance(colours.float(), background=1.0).float()

    def pictures(self, radiance: Sequence[Float[Tensor, "E V 3"]]) -> list[list[Float[Tensor, "H W 3"]]]:
        """Of every light, from every eye."""
        return [
            [self.picture(seen[min(eye, len(seen) - 1)], light, eye) for eye in range(len(self.cameras))]
            for light, seen in enumerate(radiance)
        ]

    def compare(
        self,
        found: Sequence[Sequence[Float[Tensor, "H W 3"]]],
        wanted: Sequence[Sequence[Float[Tensor, "H W 3"]]],
    ) -> tuple[float, float]:
        """PSNR in decibels, at most 100, and mean FLIP of the worst picture, both over the pixels that show the model.

        Source of FLIP: Andersson, Nilsson, Akenine-Moller, Oskarsson, Astrom and Fairchild 2020, at 67 pixels a degree.
        """
        quality, seen = MOST, 0.0
        for ours, theirs in zip(found, wanted, strict=True):
            for picture, right, model in zip(ours, theirs, self._seen, strict=True):
                quality = min(quality, psnr(picture[model], right[model]))
                seen = max(seen, float(flip(picture, right)[model].mean()))
        return quality, seen


def cameras(receivers: Receivers, eyes: Float[Tensor, "E 3"] | None, size: tuple[int, int] = SIZE) -> list[Camera]:
    """A camera at every eye that looks at the middle of the model; the usual one if no eye is given.

    Raises InputError as `frame`.
    """
    points, aspect = subject(receivers), size[0] / size[1]
    if eyes is None:
        return [frame(points, VIEW, aspect=aspect)]
    middle = (points.double().amin(0) + points.double().amax(0)) / 2
    found = []
    for eye in eyes.double():
        x, y, z = (eye - middle).tolist()
        if not (x or y or z):
            raise InputError(_blind(tuple(eye.tolist())))
        found.append(frame(points, (x, y, z), aspect=aspect, distance=float((eye - middle).norm())))
    return found


def _blind(eye: Sequence[float]) -> str:
    place = ",".join(f"{value:g}" for value in eye)
    return f"the eye at {place} sees nothing of the model: give one that looks at it from outside"


def flip(picture: Float[Tensor, "H W 3"], reference: Float[Tensor, "H W 3"]) -> Float[Tensor, "H W"]:
    """FLIP of every pixel of two sRGB pictures, 0 where nobody sees a difference, up to 1.

    Raises InputError if flip-evaluator is not installed.
    """
    check_flip()
    import flip_evaluator

    arrays = (each.detach().contiguous().numpy() for each in (reference, picture))
    found, _, _ = flip_evaluator.evaluate(*arrays, "LDR", applyMagma=False, computeMeanError=False)
    return torch.from_numpy(found)[..., 0]


def check_flip() -> None:
    """Raises InputError if flip-evaluator is not installed."""
    try:
        import flip_evaluator  # noqa: F401
    except ImportError as fault:
        raise InputError("FLIP needs flip-evaluator: install torchprt[tradeoff]") from fault
