"""Pictures of transfers and lights that show themselves in a notebook."""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.brdf import Brdf
from torchprt.errors import InputError
from torchprt.light import project
from torchprt.preview.camera import frame
from torchprt.preview.encode import encoded, image_of
from torchprt.preview.environment import Environment, automatic_exposure, built_in_environment, photograph
from torchprt.preview.ground import subject
from torchprt.preview.saving import save_picture
from torchprt.preview.volume import studio_of
from torchprt.sh import order_of
from torchprt.shade import display, shader
from torchprt.shade.display import TONE, ToneMap
from torchprt.transfer import Transfer

ROWS = 160
"""Of the picture of a light."""
Lit = str | Environment | Tensor
"""A light: one of `light.BUILT_IN`, an environment, coefficients `[N, 3]`, or a latitude-longitude map `[H, 2H, 3]`."""


@dataclass(frozen=True, eq=False)
class Picture:
    """sRGB values in [0, 1], `values [H, W, 3]`, or 4 with opacity, that a notebook shows as what they are."""

    values: Float[Tensor, "H W C"]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes `.png`, `.jpg` or `.webp`; raises InputError as `save_picture`."""
        save_picture(self.values, path)

    def _repr_png_(self) -> bytes:
        return encoded(image_of(self.values), format="PNG")

    def __repr__(self) -> str:
        height, width, channels = self.values.shape
        return f"Picture({width} x {height}{', with opacity' if channels == 4 else ''})"


def look(
    transfer: Transfer,
    light: Lit = "studio",
    *,
    brdf: Brdf | None = None,
    size: tuple[int, int] = (480, 360),
    view: tuple[float, float, float] = (0.45, 0.35, 1.0),
    exposure: float | int | None = None,
    tone: ToneMap = TONE,
) -> Picture:
    """A picture of `transfer` under a light, from the side `view`, for a notebook: `prt.preview.look(transfer)`.

    `brdf`: of transfer that leaves its reflectance open. `exposure` in stops, automatic if omitted. It is the picture
    that `torchprt render` makes with the same options.
    Raises InputError as `Studio` and `shader`, if the light is of another order, or it needs a pose.
    """
    environment = _environment(light, transfer.order)
    shaded = shader(transfer, brdf=brdf)
    studio = studio_of(transfer, shaded, environment, size=size, exposure=exposure, tone=tone)
    camera = frame(subject(transfer.receivers), view, aspect=size[0] / size[1])
    return Picture(studio.picture(camera, torch.eye(3)))


def look_at_light(light: Lit, *, exposure: float | int | None = None, tone: ToneMap = TONE) -> Picture:
    """A light as a latitude-longitude picture, black where coefficients ring below 0: `prt.preview.look_at_light(l)`.

    `exposure` in stops; if omitted that at which a white surface that faces most of the light is just white.
    Raises InputError for what is no light.
    """
    environment = _environment(light, 5)
    stops = automatic_exposure(environment.light) if exposure is None else float(exposure)
    shown = photograph(environment.light, ROWS) if environment.image is None else environment.image.float()
    if shown.shape[0] > ROWS:
        planes = torch.nn.functional.interpolate(shown.movedim(-1, 0)[None], (ROWS, 2 * ROWS), mode="area")
        shown = planes[0].movedim(0, -1)
    return Picture(display(shown, exposure=stops, tone=tone))


def _environment(light: Lit, order: int) -> Environment:
    """`light` as an environment: coefficients of whatever order they are, an image or a name at `order`."""
    if isinstance(light, Environment):
        return light
    if isinstance(light, str):
        return built_in_environment(light, order)
    image = light.detach().cpu()
    if image.ndim == 3 and image.shape[2] == 3:
        return Environment("light", project(image.float(), order), image)
    if image.ndim != 2 or image.shape[1] != 3:
        raise InputError(f"light has shape {list(image.shape)}: give coefficients [N, 3] or an image [H, 2H, 3]")
    order_of(len(image))
    return Environment("light", image.float())
