"""What is wrong with the radiance of an image, in numbers and in sentences, and how it is mended."""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from torchprt.errors import InputError

CHANNELS = ("red", "green", "blue")

# A channel this far below the brightest channel of its pixel is zero but for the rounding of the file.
DEAD = 1e-6
# Pixels that may be a sun or a lamp: near the brightest one, and far above the ordinary ones.
BRIGHT, ABOVE_MEDIAN = 1e-2, 1e2


class DamagedImageWarning(UserWarning):
    """An image held values that radiance cannot have; the message says which and what was done."""


@dataclass(frozen=True)
class ImageReport:
    """What `inspect` found. Values are counted by channel, pixels by position.

    `lowest` is the largest negative magnitude (0 if none); `minimum` and `maximum` are those of the finite
    values as found. `dead_channels` names the channels that are zero in a sun: below 1e-6 of another channel
    in pixels that reach 1 % of the brightest and 100 times the median; `dead_pixels` counts those pixels.
    `treated` and `repaired` say whether negative and non-finite values were replaced.
    """

    height: int
    width: int
    negative: int
    lowest: float
    nan: int
    infinite: int
    minimum: float
    maximum: float
    dead_channels: tuple[str, ...]
    dead_pixels: int
    treated: bool = False
    repaired: bool = False

    @property
    def damaged(self) -> bool:
        return bool(self.negative or self.nan or self.infinite or self.dead_pixels)

    def __str__(self) -> str:
        return " ".join(self.sentences())

    def sentences(self) -> list[str]:
        """One sentence for each kind of damage, or one that says there is none."""
        found = []
        if self.negative:
            done = "they were set to 0" if self.treated else "radiance cannot be"
            found.append(f"{_count(self.negative)} negative, down to {-self.lowest:.6g}: {done}.")
        if self.nan or self.infinite:
            done = (
                "they were replaced by the median of their finite neighbours"
                if self.repaired
                else "the image cannot be used as it is"
            )
            found.append(f"{self.nan} NaN and {self.infinite} infinite values: {done}.")
        if self.dead_pixels:
            channels = " or ".join(self.dead_channels)
            lamp = f"{self.dead_pixels} of the brightest pixels (up to {self.maximum:.6g})"
            found.append(
                f"{channels} is zero in {lamp}: "
                "they were left as they are, and tint the light unless the lamp really has that colour."
            )
        span = f"from {self.minimum:.6g} to {self.maximum:.6g}"
        return found or [f"Values {span}, no damage found."]


def _count(values: int) -> str:
    return "1 value is" if values == 1 else f"{values} values are"


def inspect(image: Float[Tensor, "H W 3"]) -> ImageReport:
    """What is wrong with the radiance of `image`; nothing is changed.

    Raises InputError if the image has no pixels.
    """
    if image.numel() == 0:
        raise InputError(f"the image has no pixels ({tuple(image.shape)}): give one of at least 1 x 1")
    finite = image.isfinite()
    values = image[finite]
    low, high = (float(values.min()), float(values.max())) if values.numel() else (float("nan"),) * 2
    dead = _dead(torch.where(finite, image, 0))
    return ImageReport(
        height=image.shape[0],
        width=image.shape[1],
        negative=int((values < 0).sum()),
        lowest=max(-low, 0.0),
        nan=int(image.isnan().sum()),
        infinite=int(image.isinf().sum()),
        minimum=low,
        maximum=high,
        dead_channels=tuple(name for name, any_dead in zip(CHANNELS, dead.any(0), strict=True) if any_dead),
        dead_pixels=int(dead.any(-1).sum()),
    )


def _dead(image: Float[Tensor, "H W 3"]) -> Bool[Tensor, "P 3"]:
    pixels = image.reshape(-1, 3)
    brightest = pixels.amax(-1)
    lamp = (brightest > 0) & (brightest >= BRIGHT * brightest.max())
    lamp &= brightest > ABOVE_MEDIAN * brightest.median()
    return lamp[:, None] & (pixels < DEAD * brightest[:, None])


def mend(image: Float[Tensor, "H W 3"], name: str, repair: bool) -> tuple[Float[Tensor, "H W 3"], ImageReport]:
    """`image` with negative values set to 0 and, with `repair`, those not finite replaced; the report.

    A value that is not finite becomes the median of the finite ones among its eight neighbours in its channel
    (the image closes in longitude); holes fill from their border inward.

    Raises InputError if values are not finite and `repair` is false, or if a channel has no finite value.
    """
    report = inspect(image)
    broken = ~image.isfinite()
    if broken.any() and not repair:
        raise InputError(
            f"{name} holds {report.nan} NaN and {report.infinite} infinite values: mend the file, or read it "
            "with repair=True (--repair) to replace them by the median of their finite neighbours"
        )
    if broken.reshape(-1, 3).all(0).any():
        raise InputError(f"{name} has a channel without any finite value: get the file again")
    mended = torch.where(image < 0, 0, image)
    mended[broken] = float("nan")
    while (holes := mended.isnan()).any():
        mended[holes] = _median_of_neighbours(mended, holes)
    return mended, replace(report, treated=report.negative > 0, repaired=bool(broken.any()))


def _median_of_neighbours(image: Float[Tensor, "H W 3"], holes: Bool[Tensor, "H W 3"]) -> Float[Tensor, " P"]:
    """NaN where no neighbour is finite; the lower one of the two in the middle of an even number."""
    row, column, channel = (index[:, None] for index in holes.nonzero(as_tuple=True))
    steps = torch.tensor([(down, right) for down in (-1, 0, 1) for right in (-1, 0, 1) if down or right])
    rows, columns = row + steps[:, 0], (column + steps[:, 1]) % image.shape[1]
    inside = (rows >= 0) & (rows < image.shape[0])
    around = image[rows.clamp(0, image.shape[0] - 1), columns, channel]
    return torch.where(inside, around, float("nan")).nanmedian(-1).values
