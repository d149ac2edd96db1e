"""Pictures on surfaces: texels in memory, looked up as renderers do."""

import io
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float32, Float64, Shaped
from torch import Tensor

from torchprt.errors import InputError

WRAPS = ("repeat", "mirror", "clamp")


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """Linear values of sRGB ones in [0, 1]. Source: IEC 61966-2-1."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture in memory, and how it is looked up. Made by `Map.texture`.

    `planes [C, H + 2, W + 2]` are linear: red, green, blue, and alpha if it is not 1 everywhere; row 1 is at v = 0,
    column 1 at u = 0. A border of one texel continues it as `wrap` says for u and v of what lies outside of [0, 1]:
    "repeat", "mirror" or "clamp". Between the middles of texels colours are linear, or, if `nearest`, those of the
    nearest.
    """

    planes: Float32[Tensor, "C height width"]
    wrap: tuple[str, str] = ("repeat", "repeat")
    nearest: bool = False
    _smaller: list[Float32[Tensor, "C _ _"]] = field(default_factory=list, init=False, repr=False)

    @property
    def size(self) -> tuple[int, int]:
        """Columns and rows."""
        return self.planes.shape[2] - 2, self.planes.shape[1] - 2

    def near_origin(self, corners: Float64[np.ndarray, "F 3 2"]) -> Float32[np.ndarray, "F 3 2"]:
        """Texture coordinates of faces moved by whole periods to where float32 resolves them."""
        lowest = corners.min(axis=1, keepdims=True)
        period = np.array([{"repeat": 1.0, "mirror": 2.0, "clamp": np.inf}[mode] for mode in self.wrap])
        whole = np.where(np.isfinite(period), period, 1)
        return (corners - np.where(np.isfinite(period), whole * np.floor(lowest / whole), 0)).astype(np.float32)

    def at(self, uv: Float32[Tensor, "S 2"], level: int = 0) -> Float32[Tensor, "C S"]:
        """Linear colours, and alpha if there is any, at texture coordinates.

        Of the picture made smaller by two `level` times.
        """
        planes = self.planes if level == 0 else self._level(level)
        size = (planes.shape[2] - 2, planes.shape[1] - 2)
        # The grid runs from -1 to 1 over the picture with its border.
        grid = [
            (_inside(uv[:, axis], self.wrap[axis]) * size[axis] + 1) * (2 / (size[axis] + 2)) - 1 for axis in (0, 1)
        ]
        return torch.nn.functional.grid_sample(
            planes[None],
            torch.stack(grid, -1)[None, None],
            mode="nearest" if self.nearest else "bilinear",
            padding_mode="border",
            align_corners=False,
        )[0, :, 0]

    def _level(self, level: int) -> Float32[Tensor, "C _ _"]:
        while len(self._smaller) < level:
            inner = (self._smaller[-1] if self._smaller else self.planes)[:, 1:-1, 1:-1]
            half = (-(-inner.shape[1] // 2), -(-inner.shape[2] // 2))
            self._smaller.append(bordered(torch.nn.functional.adaptive_avg_pool2d(inner[None], half)[0], self.wrap))
        return self._smaller[level - 1]


def _inside(coordinate: Float32[Tensor, "S"], mode: str) -> Float32[Tensor, "S"]:
    if mode == "repeat":
        return coordinate - coordinate.floor()
    if mode == "mirror":
        return 1 - ((coordinate % 2) - 1).abs()
    return coordinate.clamp(0, 1)


def bordered(planes: Float32[Tensor, "C H W"], wrap: tuple[str, str]) -> Float32[Tensor, "C height width"]:
    """The planes of a picture with a border of one texel that continues it."""
    result = planes.new_empty(planes.shape[0], planes.shape[1] + 2, planes.shape[2] + 2)
    result[:, 1:-1, 1:-1] = planes
    # A mirror repeats its edge, as a clamp does.
    left, right = (-2, 1) if wrap[0] == "repeat" else (1, -2)
    upper, lower = (-2, 1) if wrap[1] == "repeat" else (1, -2)
    result[:, 1:-1, 0], result[:, 1:-1, -1] = result[:, 1:-1, left], result[:, 1:-1, right]
    result[:, 0], result[:, -1] = result[:, upper], result[:, lower]
    return result


def linear_planes(texels: Shaped[np.ndarray, "H W 4"], srgb: bool) -> Float32[Tensor, "C H W"]:
    """Planes of linear red, green and blue, and of alpha where it is not 1 everywhere, of whole numbers as stored."""
    colour = _table(texels.dtype.str, srgb)
    largest = np.iinfo(texels.dtype).max
    clear = bool((texels[..., 3] != largest).any())
    planes = np.empty((4 if clear else 3, *texels.shape[:2]), np.float32)
    for plane in range(3):
        np.take(colour, texels[..., plane], out=planes[plane], mode="clip")
    if clear:
        np.divide(texels[..., 3], largest, out=planes[3])
    return torch.from_numpy(planes)


@lru_cache(maxsize=4)
def _table(kind: str, srgb: bool) -> Float32[np.ndarray, "_"]:
    """The linear value of every whole number of a type."""
    largest = np.iinfo(kind).max
    values = np.arange(largest + 1) / largest
    return (srgb_to_linear(values) if srgb else values).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture that a file names, read when it is needed, or `held` in memory. `name` is for messages."""

    name: str
    read: Callable[[], bytes]
    held: Shaped[np.ndarray, "H W 4"] | None = None

    def size(self) -> tuple[int, int]:
        """Columns and rows, by its header. Raises InputError as `texels` does."""
        width, height = self._open().size
        return int(width), int(height)

    def texels(self) -> Shaped[np.ndarray, "H W 4"]:
        """Red, green, blue and alpha as stored, uint8, or uint16 if it is grey of 16 bits; row 0 is the upper.

        Of colours of 16 bits the upper 8 are taken, which is as exact as a screen. Profiles are ignored, as glTF asks.
        Raises InputError if it is missing, damaged or of a kind that is not read (KTX2).
        """
        if self.held is not None:
            return self.held
        picture = self._open()
        try:
            if picture.mode.startswith("I;16"):
                grey = np.asarray(picture).astype(np.uint16)
                return np.stack([grey, grey, grey, np.full_like(grey, 65535)], axis=-1)
            return np.ascontiguousarray(picture.convert("RGBA"))
        except (OSError, SyntaxError, ValueError, EOFError) as fault:
            raise InputError(f"the picture {self.name} is damaged ({fault}): export it again") from fault

    def _open(self) -> Any:
        import PIL.Image

        try:
            content = self.read()
        except OSError as fault:
            raise InputError(f"the picture {self.name} cannot be read ({fault.strerror}): copy it again") from fault
        if content.startswith(b"\xabKTX"):
            raise InputError(f"the picture {self.name} is KTX2, which is not read: convert it to .png or .jpg")
        try:
            return PIL.Image.open(io.BytesIO(content))
        except PIL.UnidentifiedImageError as fault:
            raise InputError(f"the picture {self.name} is of no kind that is read: convert it to .png") from fault
        except (OSError, SyntaxError, ValueError, EOFError, PIL.Image.DecompressionBombError) as fault:
            raise InputError(f"the picture {self.name} is damaged ({fault}): export it again") from fault


@dataclass(frozen=True, eq=False)
class Map:
    """A picture on a surface: which texture coordinates it is looked up at, and how they are turned and moved first.

    `matrix [2, 3]` takes (u, v, 1) of the mesh to where the picture is looked up, v down from its upper edge.
    """

    picture: Picture
    srgb: bool
    set: int = 0
    matrix: Float[np.ndarray, "2 3"] = field(default_factory=lambda: np.eye(2, 3))
    wrap: tuple[str, str] = ("repeat", "repeat")
    nearest: bool = False

    def texture(self) -> Texture:
        """The picture in memory. Raises InputError as `Picture.texels` does."""
        planes = linear_planes(self.picture.texels(), self.srgb)
        return Texture(bordered(planes, self.wrap), self.wrap, self.nearest)

    def corners(self, uv: Float[np.ndarray, "F 3 2"]) -> Float64[np.ndarray, "F 3 2"]:
        """Where the corners of faces with these texture coordinates are looked up."""
        result: np.ndarray = np.asarray(uv, np.float64) @ self.matrix[:, :2].T + self.matrix[:, 2]
        return result
