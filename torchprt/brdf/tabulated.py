"""Reflectance without a formula: tables over angles, and functions of the user's."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf.models import Brdf
from torchprt.errors import InputError
from torchprt.sh.shapes import broadcast_shapes


@dataclass(frozen=True, eq=False)
class Tabulated(Brdf):
    """f from an array of values in 1/sr over angles, linear between them.

    - Isotropic: `values [Tv, Ts, P]`. Axis 0: the view's angle from the normal, from 0 to pi / 2, both included, in
      equal steps. Axis 1: the light's, likewise. Axis 2: the angle around the normal between the two, from 0 (the
      light on the side of the view) to pi (the mirror side), both included; the other half is its mirror image.
    - Anisotropic: `values [Tv, Pv, Ts, Ps]` with the azimuth of each from the tangent toward the bitangent, in equal
      steps around the full circle, 0 included, 2 pi not.

    The values are copied. Two tables are equal only if they are one. A transfer file keeps `spec` as a remark:
    `parse` cannot read it back, so give the table again where the reflectance is needed.
    Raises InputError if the shape does not fit, an axis has less than two steps, or a value is negative or not finite.
    """

    values: Tensor
    spec: str = "tabulated"  # type: ignore[misc]

    def __post_init__(self) -> None:
        shape = list(self.values.shape)
        if len(shape) not in (3, 4) or min(shape) < 2:
            raise InputError(
                f"values have shape {shape}: give [Tv, Ts, P] or [Tv, Pv, Ts, Ps] with at least 2 steps an axis"
            )
        if not self.values.is_floating_point():
            raise InputError(f"values are {self.values.dtype}: give floating-point numbers")
        if not bool((self.values.isfinite() & (self.values >= 0)).all()):
            raise InputError(
                "values hold negative numbers, infinities or NaN: a reflectance is finite and not negative"
            )
        object.__setattr__(self, "values", self.values.detach().clone())

    @property
    def isotropic(self) -> bool:  # type: ignore[override]
        return self.values.dim() == 3

    @property
    def reciprocal(self) -> bool:  # type: ignore[override]
        swapped = self.values.transpose(0, 1) if self.isotropic else self.values.permute(2, 3, 0, 1)
        return swapped.shape == self.values.shape and torch.allclose(swapped, self.values, rtol=1e-3, atol=0)

    @property
    def width(self) -> float:  # type: ignore[override]
        shape = self.values.shape
        angles, turns = ((0, 1), (2,)) if self.isotropic else ((0, 2), (1, 3))
        circle = math.pi if self.isotropic else 2 * math.pi
        sizes = [math.pi / 2 / (shape[axis] - 1) for axis in angles] + [circle / shape[axis] for axis in turns]
        # What a table is for is a few steps wide.
        return 4 * min(sizes)

    def _above(self, view: Tensor, light: Tensor) -> Tensor:
        values = self.values.to(view.device, torch.promote_types(view.dtype, light.dtype))
        view, light = torch.broadcast_tensors(view, light)
        tilts = tilt(view), tilt(light)
        if self.isotropic:
            (a, b), (c, d) = _sideways(view), _sideways(light)
            across, along = (a * d - b * c).abs(), a * c + b * d
            places = [steps(tilts[0], values.shape[0]), steps(tilts[1], values.shape[1])]
            places.append(steps(_angle(across, along) / 2, values.shape[2]))
        else:
            places = [
                steps(tilts[0], values.shape[0]),
                around(view, values.shape[1]),
                steps(tilts[1], values.shape[2]),
                around(light, values.shape[3]),
            ]
        total = torch.zeros_like(tilts[0])
        for corner in itertools.product((0, 1), repeat=len(places)):
            weight = torch.ones_like(total)
            index = torch.zeros_like(total, dtype=torch.long)
            for size, (low, high, part), side in zip(values.shape, places, corner, strict=True):
                weight = weight * (part if side else 1 - part)
                index = index * size + (high if side else low)
            total = total + weight * values.flatten()[index]
        return total


@dataclass(frozen=True, eq=False)
class Measured(Brdf):
    """Any `function(view, light)` of unit directions `[..., 3]` that broadcast, to f `[...]` in 1/sr without cosine.

    It is called for directions above the horizon only. `isotropic` and `reciprocal` are what the user vouches for;
    `width` is the angle in radians over which the lobe changes; integrals are refused below .012. Differentiable as
    far as the function is.
    A transfer file keeps `spec` as a remark: `parse` cannot read it back.
    Raises InputError if `width` is not positive, and when called if the function returns another shape, negative
    values or values that are not finite.
    """

    function: Callable[[Tensor, Tensor], Tensor]
    name: str = "measured"
    isotropic: bool = False
    reciprocal: bool = False
    width: float = 0.2

    def __post_init__(self) -> None:
        if not self.width > 0:
            raise InputError(f"width is {self.width:g}: give the angle over which the lobe changes, in radians")

    @property
    def spec(self) -> str:
        """ "measured:" and the name: a remark that cannot be read back."""
        return f"measured:{self.name}"

    def _above(self, view: Tensor, light: Tensor) -> Tensor:
        value = self.function(view, light)
        shape = broadcast_shapes(view.shape, light.shape)[:-1]
        if not isinstance(value, Tensor) or value.shape != shape:
            found = list(value.shape) if isinstance(value, Tensor) else type(value).__name__
            raise InputError(f"reflectance '{self.name}' returned {found}: return a tensor of shape {list(shape)}")
        if not bool((value.isfinite() & (value >= 0)).all()):
            raise InputError(
                f"reflectance '{self.name}' returned negative values, infinities or NaN: mend the function"
            )
        return value


def tilt(direction: Float[Tensor, "*D 3"]) -> Float[Tensor, "*D"]:
    """The angle from the normal, with a finite gradient at it."""
    squared = direction[..., 0].square() + direction[..., 1].square()
    off = squared > 0
    return torch.where(off, torch.atan2(torch.where(off, squared, 1.0).sqrt(), direction[..., 2]), 0.0)


def _sideways(direction: Tensor) -> tuple[Tensor, Tensor]:
    """x and y, scaled up where they are small: products of two of them would leave the range of floats."""
    sideways = direction[..., :2]
    largest = sideways.detach().abs().amax(-1, keepdim=True)
    # Where they are smaller still, gradients would leave it.
    scale = torch.where(largest > torch.finfo(direction.dtype).tiny ** 0.75, largest, 1.0)
    x, y = (sideways / scale).unbind(-1)
    return x, y


def _angle(across: Tensor, along: Tensor) -> Tensor:
    """atan2 with a finite gradient where both are zero: at the pole any azimuth will do."""
    off = (across != 0) | (along != 0)
    return torch.atan2(across, torch.where(off, along, 1.0))


def steps(angle: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """The indices on both sides of an angle from 0 to pi / 2 at `count` equal steps, and the part of the higher."""
    place = angle * ((count - 1) / (math.pi / 2))
    low = place.detach().floor().clamp(0, count - 2)
    return low.long(), low.long() + 1, (place - low).clamp(0, 1)


def around(direction: Tensor, count: int) -> tuple[Tensor, Tensor, Tensor]:
    """Likewise for the azimuth, at `count` equal steps around the full circle."""
    place = _angle(direction[..., 1], direction[..., 0]) * (count / (2 * math.pi))
    low = place.detach().floor()
    return low.long() % count, (low.long() + 1) % count, place - low
