"""The state of a preview of a volume: it is drawn on a sheet that faces the camera."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from torchprt.errors import InputError
from torchprt.preview.camera import Camera
from torchprt.preview.environment import Environment, for_pixels, seen_along
from torchprt.preview.session import PLAIN, Session
from torchprt.shade import Composite, srgb, tone_mapped
from torchprt.shade.display import linear
from torchprt.transfer import Transfer
from torchprt.words import count

SHEET = 129
"""Vertices of the sheet along either side: a ray each."""
SHOWN = ("transfer", "compressed")
"""Modes of a volume, which has no normals."""
# How far the sheet goes beyond the middle of the picture, in halves of its height.
_REACH = 3.0


class VolumeSession(Session):
    """A `Session` of a volume: `positions` are those of a sheet through its middle that faces the camera and covers
    what holds anything, and `colours` what is seen of it, with what is behind, along a ray through each vertex.

    All bakes are of one grid and have the same cells. Its modes are "transfer" and "compressed".
    Raises InputError as `Session`, and if poses are given.
    """

    has_reverse = False

    def __init__(
        self,
        bakes: Mapping[str, Transfer],
        environments: Sequence[Environment],
        *,
        poses: Float[Tensor, "T V 3"] | None = None,
        **options: Any,
    ):
        if poses is not None:
            raise InputError("poses are given, but a volume does not move: leave them out")
        super().__init__(bakes, environments, **options)
        self._subject = next(iter(bakes.values())).receivers.subject.double()
        self._rim = math.hypot(*next(iter(bakes.values())).receivers.as_cells().spacing) / 2
        self._opacity = None
        self._met: tuple[Camera, Tensor] | None = None
        self._source: tuple[object, Tensor] | None = None
        self._facing()

    def _drawn_of(self, bakes: Mapping[str, Transfer]) -> tuple[Tensor, Tensor]:
        first_name, first = next(iter(bakes.items()))
        cells = first.receivers.as_cells()
        for name, bake in bakes.items():
            other = bake.receivers.as_cells()
            if not (torch.equal(other.positions, cells.positions) and torch.equal(other.extinction, cells.extinction)):
                raise InputError(
                    f"{name} has {count(other.count, 'cell')}, {first_name} {count(cells.count, 'cell')}: give bakes "
                    "of one volume"
                )
        self.composite = Composite(cells, reading="trilinear")
        row = torch.arange(SHEET - 1)
        corner = (SHEET * row[:, None] + row).flatten()
        # Counter-clockwise from the camera: rows go down, columns to the right.
        quads = torch.stack([corner, corner + SHEET, corner + SHEET + 1, corner + 1], -1)
        return torch.zeros(SHEET * SHEET, 3).double(), torch.cat([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])

    def _facing(self) -> None:
        """Turns the sheet to the camera if that has moved."""
        camera = self.camera
        if self._met is not None and self._met[0] == camera:
            return
        forward, right, above = camera.axes()
        eye = torch.tensor(camera.eye, dtype=torch.float64)
        distance = math.dist(camera.eye, camera.target)
        reach = _REACH * math.tan(math.radians(camera.field) / 2)
        away = self._subject - eye
        depth = away @ forward
        if bool((depth > 0.01 * distance).all()):
            across, up = away @ right / depth, away @ above / depth
            # What is read between cells goes half a cell beyond them.
            rim = self._rim / float(depth.min())
            ends = (across.amin() - rim, across.amax() + rim, up.amin() - rim, up.amax() + rim)
            sides = [float(each.clamp(-reach, reach)) for each in ends]
        else:
            # The camera is in it.
            sides = [-reach, reach, -reach, reach]
        left, far_right, below, top = sides
        x = torch.linspace(left, far_right, SHEET, dtype=torch.float64)
        y = torch.linspace(top, below, SHEET, dtype=torch.float64)
        rays = forward + x[None, :, None] * right + y[:, None, None] * above
        self.positions = (eye + distance * rays).flatten(0, 1)
        self._met = camera, rays.flatten(0, 1)

    def colours(self) -> Float[Tensor, "V 3"]:
        self._facing()
        key = (
            *(self.mode, self.bake, self.packed, self.order, self.window, self.environment, self.exposure),
            *(tuple(self.rotation.flatten().tolist()), self.orbit, self.backdrop),
        )
        if self._shown is None or self._shown[0] != key:
            self._shown = key, self._make_colours()
        return self._shown[1]

    def source(self) -> Float[Tensor, "V 3"]:
        """The source radiance of every cell, made again only if the light, or the eye that it follows, has changed."""
        key = (
            *(self.mode, self.bake, self.packed, self.order, self.window, self.environment),
            *(tuple(self.rotation.flatten().tolist()), self.orbit if self.follows_eye else None),
        )
        if self._source is None or self._source[0] != key:
            self._source = key, self.radiance().float()
        return self._source[1]

    def _make_colours(self) -> Tensor:
        assert self._met is not None
        camera, rays = self._met
        with torch.no_grad():
            seen, through = self.composite(self.source(), torch.tensor(camera.eye).double()[None], rays)
        seen, through = seen.float(), through.float()[:, None]
        hidden = 1 - through
        # As pictures are made: what is behind is mixed in as it is shown.
        mean = seen.clamp(min=0) / torch.where(hidden > 0, hidden, 1.0)
        model = tone_mapped(mean, exposure=self.stops, tone=self.tone)
        return srgb(model * hidden + self._behind(rays) * through)

    def _behind(self, rays: Tensor) -> Tensor:
        """Linear RGB of what is behind the sheet, as it is shown."""
        image = self.backdrop_image()
        if image is None:
            return linear(torch.full((3,), PLAIN))
        texel = math.radians(self.camera.field) / SHEET
        return linear(seen_along(for_pixels(image.float(), texel), rays, self.rotation).float())

    # Changes

    def advance(self, seconds: float | int) -> None:
        """A volume does not move."""

    def set_mode(self, mode: str) -> str:
        if mode in SHOWN:
            return super().set_mode(mode)
        return f"mode: {self.mode}; {mode} is for surfaces, a volume has none"

    def next_mode(self) -> str:
        return self.set_mode(SHOWN[(SHOWN.index(self.mode) + 1) % len(SHOWN)])

    def pick(self, x: float | int, y: float | int, width: int, height: int) -> str:
        return "no cell can be picked: many are seen along a ray"


def session_of(bakes: Mapping[str, Transfer], environments: Sequence[Environment], **options: Any) -> Session:
    """A session of bakes of a mesh, or of a volume; InputError as both."""
    volumes = [not bake.receivers.on_surface for bake in bakes.values()]
    if volumes and all(volumes):
        return VolumeSession(bakes, environments, **options)
    if any(volumes):
        raise InputError("a window shows a surface or a volume: give bakes of one of them")
    return Session(bakes, environments, **options)
