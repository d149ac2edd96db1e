"""Pictures of a volume: its cells shaded, and composited along the rays of a camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from torchprt.errors import InputError
from torchprt.sh.basis import values_are_at_hand
from torchprt.shade.composite import Composite, Reading
from torchprt.shade.rays import pinhole
from torchprt.shade.shader import shader
from torchprt.transfer import Transfer


class VolumeShader(nn.Module):
    """Pictures of a volume under lights, from eyes: `shader` gives the source radiance of its cells, which `composite`
    brings to the pixels of a pinhole camera.

    `size`: of a picture, width and height; `field`: its vertical angle of view in degrees; `target`: where cameras look
    if a call does not say it, the middle of the grid if omitted; +y is up. `reading`, `samples`: as for `Composite`;
    `dtype`, `learn`: as for `torchprt.shader`, which may also name "extinction".

    Raises InputError as these, if the transfer is of no volume, or if `size` or `field` leave no picture.
    Source: Sloan, Kautz and Snyder 2002, section 7.
    """

    target: Tensor

    def __init__(
        self,
        transfer: Transfer,
        *,
        size: tuple[int, int] = (256, 256),
        field: float | int = 35.0,
        target: Sequence[float] | None = None,
        reading: Reading = "exact",
        samples: int | None = None,
        dtype: torch.dtype | None = None,
        learn: Iterable[str] = (),
    ) -> None:
        super().__init__()
        cells = transfer.receivers.as_cells()
        if min(size) < 1:
            raise InputError(f"size {size[0]}x{size[1]} has no pixels: give width and height from 1")
        if not 0 < field < 180:
            raise InputError(f"field is {field}: give degrees between 0 and 180")
        self.size, self.field = (int(size[0]), int(size[1])), float(field)
        learned = {learn} if isinstance(learn, str) else set(learn)
        self.shader = shader(transfer, dtype=dtype, learn=learned - {"extinction"})
        self.composite = Composite(
            cells, reading=reading, samples=samples, dtype=self.shader.dtype, learn=learned & {"extinction"}
        )
        low, high = cells.box
        middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)] if target is None else list(target)
        place = torch.tensor(middle, dtype=torch.float64, device=transfer.positions.device)
        if place.shape != (3,) or not bool(place.isfinite().all()):
            raise InputError(f"target is {target}: give a point, three finite numbers")
        self.register_buffer("target", place.to(self.composite.step.dtype), persistent=False)

    @property
    def order(self) -> int:
        """Number of SH bands of the light."""
        return self.shader.order

    def extra_repr(self) -> str:
        return f"size={self.size}, field={self.field}"

    def source(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"],
    ) -> Float[Tensor, "... V 3"]:
        """The source radiance of every cell toward an eye."""
        seen: dict[str, Any] = {"eye": eye} if "eye" in self.shader.needs else {}
        radiance: Tensor = self.shader(light, rotation, **seen)
        return radiance

    def forward(
        self,
        light: Float[Tensor, "*#B N 3"],
        rotation: Float[Tensor, "*#B 3 3"] | None = None,
        *,
        eye: Float[Tensor, "*#B 3"],
        target: Float[Tensor, "*#B 3"] | None = None,
    ) -> Float[Tensor, "... H W 4"]:
        """Pictures: linear radiance, and in the fourth channel the share of what is behind that is hidden, 1 less the
        transmittance. Radiance is what the volume adds (premultiplied): before a background it is
        `rgb + (1 - alpha) * background`.

        `light [..., N, 3]` and `rotation [..., 3, 3]`, which turns it, as for `Shader`; `eye [..., 3]` and
        `target [..., 3]` in the world. All batches broadcast; one eye for many lights is met once.
        Raises InputError as `Shader` and `Composite`, and if the eye is at the target.
        """
        source = self.source(light, rotation, eye=eye)
        place = self.target if target is None else target
        wide = torch.promote_types(eye.dtype, self.composite.step.dtype)
        eye, place = eye.to(wide), place.to(wide)
        if eye.shape[-1:] != (3,) or place.shape[-1:] != (3,):
            raise InputError(f"eye and target have shapes {list(eye.shape)} and {list(place.shape)}: give [..., 3]")
        if values_are_at_hand(eye, place) and bool((eye == place).all(-1).any()):
            raise InputError("the eye is at the target: move one of them")
        width, height = self.size
        rays = pinhole(eye, place, self.size, self.field).flatten(-3, -2)
        radiance, through = self.composite(source, eye.unsqueeze(-2), rays)
        whole = torch.cat([radiance, 1 - through.unsqueeze(-1)], -1)
        return whole.unflatten(-2, (height, width))
