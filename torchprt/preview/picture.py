"""Still pictures without a display: Embree casts the camera's rays."""

from __future__ import annotations

import copy
import os
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import embedding_bag

from torchprt.errors import InputError
from torchprt.files import write
from torchprt.preview.camera import Camera, frame
from torchprt.preview.encode import encoded, image_of
from torchprt.preview.ground import opacity as opacity_of
from torchprt.shade import srgb, tone_mapped
from torchprt.shade.display import TONE, ToneMap, linear
from torchprt.trace import Mirrors, Tracer, follow
from torchprt.transfer import Receivers

SAMPLES = 4
"""Rays a pixel."""
MIDDLE, CORNER = (0.36, 0.37, 0.39), (0.13, 0.135, 0.145)
"""sRGB of the plain background behind the model and far from it."""
GOLDEN = (5**0.5 - 1) / 2


class Still:
    """A model seen by a camera: the hits are found once, then every light and rotation is an interpolation.

    `positions [V, 3]`, `faces [F, 3]`; `size` in pixels (width, height); `samples` rays a pixel, in a pattern in which
    no two share a row or a column of it. `opacity [V]`: 0 where a vertex lets through what is behind the model.
    `mirrors`: positions, normals, reflectance `[P, 3]` and faces `[T, 3]` of mirrors, which show the model and, along
    `sky [E, 3]`, what surrounds it.
    The camera of `frame` if none is given. Back faces are black: they reflect nothing.
    Raises InputError if the model has no faces or the picture no pixels.
    """

    _sky: _Sky | None
    _tint: Tensor | None
    _plain: Tensor | None
    _veil: Tensor | None
    _read: Callable[[Tensor], Tensor] | None = None

    def __init__(
        self,
        positions: Float[Tensor, "V 3"],
        faces: Tensor,
        *,
        size: tuple[int, int] = (800, 600),
        camera: Camera | None = None,
        samples: int = SAMPLES,
        opacity: Float[Tensor, "V"] | None = None,
        mirrors: tuple[Tensor, Tensor, Tensor, Tensor] | None = None,
    ):
        if len(faces) == 0:
            raise InputError("a picture needs faces, this transfer was recorded at loose points: write .npy or .ply")
        _check_pixels(size, samples)
        width, height = size
        self.camera = camera or frame(positions, aspect=width / height)
        self.size = size
        self._samples = samples
        tracer, mirror = _with_mirrors(positions, faces, mirrors)
        eye = torch.tensor(self.camera.eye, dtype=torch.float64)
        directions = self.directions().view(height * width, samples, 3)
        hits = tracer.camera(eye, directions)
        shiny = torch.zeros(0, dtype=torch.int64)
        if mirror is not None:
            shiny = torch.nonzero((hits.triangle >= len(faces)).flatten())[:, 0]
            reflected = follow(tracer, mirror, hits, shiny, directions.reshape(-1, 3)[shiny])
            for part in ("triangle", "u", "v", "front"):
                getattr(hits, part).view(-1)[shiny] = getattr(reflected, part)
        # A ray that never leaves the mirrors shows them black.
        seen = (hits.triangle >= 0) & (hits.triangle < len(faces))
        triangle, front = hits.triangle[seen].long(), hits.front[seen]
        corners = faces.long()[triangle]
        if not bool(front.all()):
            # A two-sided surface is there twice, and Embree may have met either: the side that faces us counts.
            reverse = reverse_corners(positions, faces)[triangle]
            twin = ~front & (reverse[:, 0] >= 0)
            corners, front = torch.where(twin[:, None], reverse, corners), front | twin
        u, v = hits.u[seen], hits.v[seen]
        weights = torch.stack([1 - u - v, u, v], -1)
        solid = torch.ones(len(u)) if opacity is None else (opacity.float()[corners] * weights).sum(-1).clamp(0, 1)
        self._vertices = len(positions)
        self._corners = corners.flatten()
        # Where the rays met the model: face, places in it and what of a pixel each stands for.
        self._hits = (triangle, weights, torch.where(front, solid / samples, 0))
        self._counts = seen.sum(1)
        # What each corner of each hit adds to its pixel; hits lie in the order of the pixels.
        self._weights = torch.where(front[:, None], weights * (solid[:, None] / samples), 0).flatten()
        self._starts = 3 * torch.cat([torch.zeros(1, dtype=torch.int64), self._counts.cumsum(0)])
        self._through = torch.where(hits.triangle < len(faces), 1.0, 0.0).masked_scatter_(seen, 1 - solid)
        self._sky = None
        self._tint = None
        if len(shiny):
            # A faded ground is as transparent in a mirror.
            share = reflected.share * self._through.flatten()[shiny, None] / samples
            self._sky = _Sky(shiny // samples, reflected.direction, share)
            tint = torch.ones(*seen.shape, 3).view(-1, 3)
            tint[shiny] = reflected.share
            self._tint = tint.view(*seen.shape, 3)[seen].repeat_interleave(3, 0)
            self._through.view(-1)[shiny] = 0
        self._plain = None
        self._seen, self._veil = seen, None

    @classmethod
    def of(
        cls,
        receivers: Receivers,
        *,
        size: tuple[int, int] = (800, 600),
        camera: Camera | None = None,
        samples: int = SAMPLES,
        mirrors: bool = True,
    ) -> Still:
        """Of what `receivers` are drawn on, with their mirrors (or without) and a ground that fades: its pictures are
        of a radiance for each of them, which is read at every hit where they are not its vertices."""
        positions, _, faces = receivers.surface
        made = cls(
            *(positions, faces),
            size=size,
            camera=camera or frame(receivers.subject, aspect=size[0] / size[1]),
            samples=samples,
            opacity=opacity_of(receivers),
            mirrors=receivers.mirrors if mirrors else None,
        )
        if receivers.surface_uv is None:
            return made
        face, weights = made.hits
        made = made.of_hits()
        made._vertices, made._read = receivers.count, lambda values: receivers.at(values, face, weights)
        return made

    @classmethod
    def empty(cls, *, size: tuple[int, int], camera: Camera, samples: int = SAMPLES) -> Still:
        """The picture of nothing at all, before which something may stand that is no surface (`veiled`)."""
        _check_pixels(size, samples)
        made = cls.__new__(cls)
        pixels = size[0] * size[1]
        made.size, made.camera, made._samples, made._vertices = size, camera, samples, 0
        made._corners, made._weights = torch.zeros(0, dtype=torch.int64), torch.zeros(0)
        made._hits = (made._corners, torch.zeros(0, 3), torch.zeros(0))
        made._counts = torch.zeros(pixels, dtype=torch.int64)
        made._starts = torch.zeros(pixels + 1, dtype=torch.int64)
        made._through = torch.ones(pixels, samples)
        made._seen = torch.zeros(pixels, samples, dtype=torch.bool)
        made._sky = made._tint = made._plain = made._veil = None
        return made

    def distances(self, positions: Float[Tensor, "V 3"], faces: Int[Tensor, "F 3"]) -> Float[Tensor, "H W S"]:
        """From the eye to the surface along every ray, infinity where it meets none."""
        far = torch.full(self._seen.shape, torch.inf, dtype=torch.float64)
        triangle, weights = self.hits
        if len(triangle):
            places = (positions.double()[faces.long()[triangle]] * weights.double()[..., None]).sum(1)
            far[self._seen] = (places - torch.tensor(self.camera.eye, dtype=torch.float64)).norm(dim=-1)
        return far.view(self.size[1], self.size[0], -1)

    def veiled(self, radiance: Float[Tensor, "H W S 3"], through: Float[Tensor, "H W S"]) -> Still:
        """The same seen through something that adds `radiance` along every ray and lets the share `through` pass."""
        made = copy.copy(self)
        rays = through.reshape(self._through.shape).to(self._through)
        triangle, weights, share = self._hits
        left = rays[self._seen]
        made._hits = triangle, weights, share * left
        made._weights = self._weights * left.repeat_interleave(len(self._corners) // max(len(left), 1))
        made._through = self._through * rays
        veil = radiance.reshape(*rays.shape, 3).mean(1)
        made._veil = veil if self._veil is None else veil + self._veil
        return made

    def directions(self) -> Float[Tensor, "H W S 3"]:
        """The world direction of every ray, in the order of the samples."""
        width, height = self.size
        across, down = _pattern(self._samples)
        x = torch.arange(width, dtype=torch.float64)[None, :, None] + across
        y = torch.arange(height, dtype=torch.float64)[:, None, None] + down
        return self.camera.through(x, y, width, height)

    @property
    def hits(self) -> tuple[Int[Tensor, "E"], Float[Tensor, "E 3"]]:
        """Of every ray that met the model the face, and the weights of its three corners there."""
        return self._hits[0], self._hits[1]

    def of_hits(self) -> Still:
        """The same picture of a radiance for every one of the `hits`, in place of every vertex."""
        triangle, _, share = self._hits
        made = copy.copy(self)
        made._vertices, made._corners, made._weights = len(triangle), torch.arange(len(triangle)), share
        made._starts = torch.cat([torch.zeros(1, dtype=torch.int64), self._counts.cumsum(0)])
        made._tint = None if self._tint is None else self._tint[::3]
        return made

    @property
    def sky(self) -> Float[Tensor, "E 3"]:
        """The world directions in which mirrors show what surrounds the model."""
        return torch.zeros(0, 3) if self._sky is None else self._sky.directions

    @property
    def coverage(self) -> Float[Tensor, "H W"]:
        """The share of each pixel that the model covers."""
        return 1 - self._through.mean(1).view(self.size[1], self.size[0])

    def radiance(
        self,
        vertex_radiance: Float[Tensor, "V 3"],
        background: float | Float[Tensor, "H W 3"] = 0.0,
        sky: Float[Tensor, "E 3"] | None = None,
    ) -> Float[Tensor, "H W 3"]:
        """The picture of linear radiance before a `background`, one for all pixels or one for each.

        `sky`: the radiance of what surrounds the model along each of the directions `sky` that its mirrors show.
        Raises InputError unless there is a radiance for every vertex.
        """
        return self._light(vertex_radiance, sky) + background * self._behind().to(vertex_radiance)

    def picture(
        self,
        vertex_radiance: Float[Tensor, "V 3"],
        *,
        exposure: float = 0.0,
        tone: ToneMap = TONE,
        background: float | Float[Tensor, "H W 3"] | None = None,
        sky: Float[Tensor, "E 3"] | None = None,
    ) -> Float[Tensor, "H W 3"]:
        """The picture as sRGB in [0, 1] before `background`, linear RGB as it is to be shown; None is a plain one.

        What a pixel shows of the model is tone mapped before it is mixed with what is behind: an edge before a lamp is
        as smooth as any.
        """
        behind = self.plain() if background is None else background
        model = tone_mapped(self._mean(vertex_radiance, sky), exposure=exposure, tone=tone)
        through = self._behind().to(model)
        return srgb(model * (1 - through) + behind * through)

    def cutout(
        self,
        vertex_radiance: Float[Tensor, "V 3"],
        *,
        exposure: float = 0.0,
        tone: ToneMap = TONE,
        sky: Float[Tensor, "E 3"] | None = None,
    ) -> Float[Tensor, "H W 4"]:
        """The picture with a fourth channel, the share of each pixel that the model covers (not premultiplied)."""
        model = srgb(tone_mapped(self._mean(vertex_radiance, sky), exposure=exposure, tone=tone))
        return torch.cat([model, self.coverage[..., None].to(model)], -1)

    def plain(self) -> Float[Tensor, "H W 3"]:
        """The background where nothing else is asked for, linear RGB: grey, lighter behind the model."""
        if self._plain is None:
            width, height = self.size
            x = ((torch.arange(width) + 0.5) / width - 0.5) * (width / max(width, height))
            y = ((torch.arange(height) + 0.5) / height - 0.5) * (height / max(width, height))
            far = (torch.hypot(x[None, :], y[:, None]) / 0.65).clamp(max=1)
            # Without an edge in the middle or at the rim.
            share = (far * far * (3 - 2 * far))[..., None]
            self._plain = linear(torch.lerp(torch.tensor(MIDDLE), torch.tensor(CORNER), share))
        return self._plain

    def _light(self, radiance: Tensor, sky: Tensor | None = None) -> Tensor:
        """What the model adds to each pixel, `[H, W, 3]`."""
        if len(radiance) != self._vertices:
            raise InputError(f"radiance of {len(radiance)} vertices for a model of {self._vertices}: give each one")
        if self._read is not None:
            radiance = self._read(radiance)
        weights = self._weights.to(radiance)
        if self._tint is None:
            total = self._sum(radiance, weights)
        else:
            tints = self._tint.to(radiance).unbind(1)
            shares = zip(radiance.unbind(1), tints, strict=True)
            total = torch.cat([self._sum(values[:, None], weights * tint) for values, tint in shares], 1)
        if self._sky is not None and sky is not None:
            total = total.index_add(0, self._sky.pixel, self._sky.share.to(radiance) * sky.to(radiance))
        if self._veil is not None:
            total = total + self._veil.to(radiance)
        return total.view(self.size[1], self.size[0], 3)

    def _sum(self, values: Tensor, weights: Tensor) -> Tensor:
        if not len(self._corners):
            return values.new_zeros(len(self._counts), values.shape[1])
        return embedding_bag(
            self._corners,
            values.contiguous(),
            self._starts,
            mode="sum",
            per_sample_weights=weights,
            include_last_offset=True,
        )

    def _mean(self, radiance: Tensor, sky: Tensor | None) -> Tensor:
        """The mean radiance of what each pixel shows of the model; 0 where it shows nothing."""
        covered = 1 - self._behind().to(radiance)
        return self._light(radiance, sky) / torch.where(covered > 0, covered, 1.0)

    def _behind(self) -> Tensor:
        """The share of each pixel that is background, `[H, W, 1]`."""
        return self._through.mean(1).view(self.size[1], self.size[0], 1)


def _check_pixels(size: tuple[int, int], samples: int) -> None:
    width, height = size
    if width < 1 or height < 1 or samples < 1:
        raise InputError(f"size {width}x{height} with {samples} samples has no pixels: give numbers from 1")


@dataclass(frozen=True, eq=False)
class _Sky:
    """Rays that mirrors turn out of the scene: their pixels, directions, and the share of the pixel that they show."""

    pixel: Int[Tensor, "E"]
    directions: Float[Tensor, "E 3"]
    share: Float[Tensor, "E 3"]


def _with_mirrors(
    positions: Tensor, faces: Tensor, mirrors: tuple[Tensor, Tensor, Tensor, Tensor] | None
) -> tuple[Tracer, Mirrors | None]:
    """A tracer of the model and, after its faces, of the mirrors."""
    if mirrors is None:
        return Tracer(positions, faces, few=True), None
    places, normals, reflectance, corners = mirrors
    kinds, number = torch.unique(reflectance[corners[:, 0].long()], dim=0, return_inverse=True)
    of_faces = torch.cat([torch.full((len(faces),), -1), number])
    smooth = torch.cat([torch.zeros(len(positions), 3), normals.float()])
    everything = torch.cat([positions.double(), places.double()])
    shown = torch.cat([faces.long(), corners.long() + len(positions)])
    return Tracer(everything, shown, few=True), Mirrors(of_faces, kinds, smooth)


def _pattern(count: int) -> tuple[Float[Tensor, "S"], Float[Tensor, "S"]]:
    """Places of `count` samples in a pixel: one in each of as many rows and columns, as a rotated grid is."""
    steps = torch.arange(count, dtype=torch.float64)
    rows = ((steps + 0.5) * GOLDEN % 1).argsort().argsort()
    return (steps + 0.5) / count, (rows + 0.5) / count


def reverse_corners(positions: Tensor, faces: Tensor) -> Tensor:
    """`[F, 3]`: for each corner of a face the vertex at its place of the face's other side; -1 where there is none."""
    _, place = torch.unique(positions, dim=0, return_inverse=True)
    places, by_place = place[faces.long()].sort(-1)
    _, group = torch.unique(places, dim=0, return_inverse=True)
    # Faces over the same places show opposite sides if their corners run round them in opposite senses.
    key = 2 * group + ((by_place[:, 1] - by_place[:, 0]) % 3 == 1)
    face_of = torch.full((2 * len(faces),), -1).scatter_reduce(0, key, torch.arange(len(faces)), "amax")
    twin = face_of[key ^ 1]
    sorted_vertices = faces.long().gather(1, by_place)
    reverse = sorted_vertices[twin.clamp(min=0)].gather(1, by_place.argsort(-1))
    return torch.where(twin[:, None] >= 0, reverse, -1)


def save_png(picture: Float[Tensor, "H W C"], path: str | os.PathLike[str]) -> None:
    """Writes sRGB values in [0, 1] as 8-bit PNG, a fourth channel as opacity.

    Raises InputError if `path` cannot be written.
    """
    write(path, encoded(image_of(picture), format="PNG"))
