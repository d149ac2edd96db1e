"""Rays of surfaces through a volume: what is left of the light that comes along them, and what it adds to that."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from torchprt.errors import InputError
from torchprt.scene import Volume
from torchprt.sh import basis
from torchprt.trace import Hits, Tracer, starts
from torchprt.transfer import Transfer

# Rays followed at a time, so that what is known of them stays in a core's cache.
_RAYS = 1 << 16
# Planes after which rays that are through are left behind.
_REST = 12
# Numbers that are gathered from cells at a time.
_NUMBERS = 1 << 23


@dataclass(frozen=True, eq=False)
class Emission:
    """What cells send: the source radiance of cell k along a ray in the direction s is `sum_m y_m(s) table[k, m]`,
    over channels and light coefficients, or `table[k, 0]` where they send alike in all directions.

    The last row is that of cells that hold nothing, zero.
    """

    table: Float[Tensor, "K M W"]
    channels: int

    @property
    def alike(self) -> bool:
        return self.table.shape[1] == 1

    def functions(self, directions: Float[Tensor, "E 3"]) -> Float[Tensor, "E M"]:
        """The `y_m` along rays."""
        if self.alike:
            return torch.ones(len(directions), 1)
        return basis(directions, math.isqrt(self.table.shape[1]))

    def weighted(
        self, row: Int[Tensor, "E"], values: Float[Tensor, "E M"], cells: Tensor, gains: Float[Tensor, "E S"], rows: int
    ) -> Float[Tensor, "v W"]:
        """The sum over rays of what they gain, a row a receiver: their functions weighted, `values`."""
        count, functions = self.table.shape[:2]
        vectors = torch.zeros(rows * count, functions)
        places = (row[:, None] * count + cells).flatten()
        vectors.index_add_(0, places, (gains[..., None] * values[:, None]).flatten(0, 1))
        return vectors.view(rows, -1) @ self.table.flatten(0, 1)

    def along(
        self, functions: Float[Tensor, "E M"], cells: Int[Tensor, "E S"], gains: Float[Tensor, "E S"]
    ) -> Float[Tensor, "E W"]:
        """What each ray gains."""
        table, found = self.table.flatten(1), []
        for some in torch.arange(len(cells)).split(max(1, _NUMBERS // table.shape[1])):
            sums = torch.nn.functional.embedding_bag(cells[some], table, mode="sum", per_sample_weights=gains[some])
            found.append((functions[some][:, None] @ sums.unflatten(1, self.table.shape[1:]))[:, 0])
        return torch.cat(found)


@dataclass(frozen=True, eq=False)
class ThroughVolume:
    """A volume that light goes through on its way to surfaces, and what its cells send, if that is known.

    `corner`: the lowest corner, in the world, of the cells that are kept; `extinction [X, Y, Z]` and `number
    [X, Y, Z]`, the row of each cell in the table of `emission`, have a border of empty cells outside of that.
    """

    corner: Float[Tensor, "3"]
    spacing: Float[Tensor, "3"]
    extinction: Float[Tensor, "X Y Z"]
    number: Int[Tensor, "X Y Z"]
    emission: Emission | None = None

    @property
    def channels(self) -> int:
        """Of the light that comes to surfaces: 3 if the volume colours it."""
        return 1 if self.emission is None else self.emission.channels

    def contents(self) -> list[Tensor]:
        """All that results depend on."""
        sent = [] if self.emission is None else [self.emission.table]
        return [self.corner, self.spacing, self.extinction, *sent]

    def left(
        self,
        tracer: Tracer,
        origins: Float[Tensor, "v *S 3"],
        frames: Float[Tensor, "v 3 3"],
        directions: Float[Tensor, "D 3"],
        wanted: Bool[Tensor, "v D"],
    ) -> Float[Tensor, "v D"]:
        """The share of light that is left on its way along each ray of a receiver, e^-(the integral of extinction), 1
        where it is not `wanted`. `origins`, `frames` and `directions` as for `Tracer.visibility`."""
        found = torch.ones(wanted.shape)
        rays = _Rays(self, tracer, origins, directions @ frames, torch.where(wanted, torch.inf, 0.0))
        for rows in rays.groups():
            which, _, (left, _, _) = rays.followed(rows, record=False)
            found[rows].view(-1)[which] = left
        return found

    def seen(
        self,
        tracer: Tracer,
        origins: Float[Tensor, "v *S 3"],
        frames: Float[Tensor, "v 3 3"],
        directions: Float[Tensor, "D 3"],
        hits: Hits,
        weights: Float[Tensor, "D"],
        *,
        along_rays: bool = False,
    ) -> Seen:
        """What is left along each ray up to its hit, and what cells send along it, weighted with `weights`;
        `along_rays`: also what comes along each ray by itself."""
        count, emission = len(directions), self.emission
        rays = _Rays(self, tracer, origins, directions @ frames, tracer.distances(origins, hits))
        found = Seen(torch.ones(hits.triangle.shape), None, None, self.channels)
        if emission is not None:
            found.arrives = torch.zeros(len(origins), emission.table.shape[2])
            if along_rays:
                found.radiance = torch.zeros(len(origins), count, emission.table.shape[2])
        for rows in rays.groups(0 if emission is None else emission.table[..., 0].numel()):
            which, toward, (left, cells, gains) = rays.followed(rows, record=emission is not None)
            found.left[rows].view(-1)[which] = left
            if emission is None or not len(which):
                continue
            functions = emission.functions(toward)
            if found.arrives is not None:
                values = functions * weights[which % count][:, None]
                found.arrives[rows] = emission.weighted(which // count, values, cells, gains, rows.stop - rows.start)
            if found.radiance is not None:
                found.radiance[rows].view(-1, found.radiance.shape[2])[which] = emission.along(functions, cells, gains)
        return found


@dataclass
class Seen:
    """What a block of receivers sees through a volume, and of it.

    `left [v, D]`: of the light along each ray. What cells send over channels and light coefficients, if that is known:
    `arrives [v, W]`, weighted and summed over the rays, and `radiance [v, D, W]` along each of them.
    """

    left: Float[Tensor, "v D"]
    arrives: Float[Tensor, "v W"] | None
    radiance: Float[Tensor, "v D W"] | None
    channels: int

    def direct(self) -> Float[Tensor, "C N v"] | float:
        """What arrives, in the layout of vectors; 0 if nothing is known of it."""
        return 0.0 if self.arrives is None else self.arrives.unflatten(1, (self.channels, -1)).permute(1, 2, 0)


class _Rays:
    """Rays of receivers in cells; a length along one is one of the frame of the tracer."""

    def __init__(
        self,
        volume: ThroughVolume,
        tracer: Tracer,
        origins: Float[Tensor, "v *S 3"],
        toward: Float[Tensor, "v D 3"],
        ends: Float[Tensor, "v D"],
    ):
        self.volume, self.toward, self.unit = volume, toward, 1 / float(tracer.scale)
        per_cell = 1 / (tracer.scale * volume.spacing)
        # One a receiver for all of its rays, or one a ray.
        origins = origins if origins.ndim == 2 else starts(origins, toward.shape[1])
        self.start = origins.double() * per_cell + (tracer.centre - volume.corner) / volume.spacing
        self.start = self.start.to(torch.float32)
        self.per_cell = per_cell.to(torch.float32)
        self.high = torch.tensor(volume.extinction.shape, dtype=torch.float32) - 2
        self.ends = ends

    def groups(self, numbers: int = 0) -> Iterator[slice]:
        """Slices of the receivers that are followed at a time; with `numbers`, of which each takes so many, what they
        cross is recorded."""
        count, rays = self.toward.shape[:2]
        step = _RAYS // rays
        if numbers:
            step = min(step, _NUMBERS // numbers, _NUMBERS // (rays * sum(self.volume.extinction.shape)))
        step = max(1, step)
        return (slice(first, min(first + step, count)) for first in range(0, count, step))

    def followed(self, rows: slice, *, record: bool) -> tuple[Tensor, Tensor, tuple[Tensor, Tensor, Tensor]]:
        """The rays of some receivers that meet the box: which of them, their directions, and what `_follow` finds."""
        step = self.toward[rows] * self.per_cell
        # A direction along a plane meets it far away.
        step = torch.where(step.abs() < 1e-20, 1e-20, step)
        start = self.start[rows] if self.start.ndim == 3 else self.start[rows, None]
        first, last = -start / step, (self.high - start) / step
        near = torch.minimum(first, last).amax(-1).clamp(min=0)
        far = torch.minimum(torch.maximum(first, last).amin(-1), self.ends[rows])
        which = torch.nonzero((far > near).flatten())[:, 0]
        found = _follow(
            self.volume.extinction,
            self.volume.number if record else None,
            self.unit,
            start.expand_as(step).flatten(0, 1)[which],
            step.flatten(0, 1)[which],
            near.flatten()[which],
            far.flatten()[which],
        )
        return which, self.toward[rows].flatten(0, 1)[which], found


def _follow(
    extinction: Float[Tensor, "X Y Z"],
    number: Int[Tensor, "X Y Z"] | None,
    unit: float,
    start: Float[Tensor, "E 3"],
    step: Float[Tensor, "E 3"],
    near: Float[Tensor, "E"],
    far: Float[Tensor, "E"],
) -> tuple[Float[Tensor, "E"], Int[Tensor, "E S"], Float[Tensor, "E S"]]:
    """What is left of light along rays from `near` to `far`; with `number` also the cells that each crosses, and what
    it gains of their source radiance, e^-(depth in front of it) (1 - e^-(its own depth)). `unit`: lengths of the world
    in one along a ray, a power of two.

    Exact for cells that are uniform, up to rounding.
    Source: Amanatides and Woo 1987, A Fast Voxel Traversal Algorithm for Ray Tracing.
    """
    # Components first: sums over rays that stream. Lengths count from where rays meet the box, not to lose digits.
    start, step, far = (start + near[:, None] * step).T, step.T, far - near
    shape = torch.tensor(extinction.shape)[:, None]
    strides = torch.tensor(extinction.stride())[:, None]
    cell = torch.minimum(start.floor().long() + 1, shape - 1).clamp(min=0)
    # Where the next plane of each axis is met, and how far apart they are.
    following = (cell - 1 + (step > 0).long() - start) / step
    apart = step.abs().reciprocal()
    stride = torch.where(step > 0, strides, -strides)
    place, at, depth = (cell * strides).sum(0), torch.zeros_like(near), torch.zeros_like(near)
    flat, numbers = extinction.flatten(), None if number is None else number.flatten()
    cells, depths = [], [depth]
    whole, rays = depth.clone(), torch.arange(len(near))
    for crossed in range(sum(extinction.shape)):
        going = at < far
        if not bool(going.any()):
            break
        if numbers is None and crossed % _REST == 0 and crossed:
            # Those that are through need not be carried along.
            whole[rays] = depth
            kept = torch.nonzero(going)[:, 0]
            rays, place, at, depth, far = (each[kept] for each in (rays, place, at, depth, far))
            following, apart, stride = (each[:, kept] for each in (following, apart, stride))
            going = going[kept]
        plane, axis = following.min(0)
        until = torch.minimum(plane, far).clamp(min=at)
        depth = depth + flat[place] * (until - at) * unit
        if numbers is not None:
            cells.append(numbers[place])
            depths.append(depth)
        at, axis = until, axis[None]
        place = place + torch.where(plane < far, stride.gather(0, axis)[0], 0)
        following.scatter_add_(0, axis, apart.gather(0, axis))
    whole[rays] = depth
    left = torch.exp(-whole)
    if not cells:
        return left, torch.zeros(len(near), 0, dtype=torch.int32), torch.zeros(len(near), 0)
    before, after = torch.stack(depths[:-1], 1), torch.stack(depths[1:], 1)
    return left, torch.stack(cells, 1), torch.exp(-before) * -torch.expm1(before - after)


def through(volume: Volume | Transfer | None, order: int) -> ThroughVolume | None:
    """What rays go through: a volume, which casts shadow alone, or what was baked of one, which also sends light.

    Raises InputError if the transfer is none of cells, or is of fewer bands than `order`.
    """
    if volume is None:
        return None
    if isinstance(volume, Volume):
        places = torch.nonzero(volume.occupied)
        values = volume.extinction[places.unbind(1)]
        return _cropped(places, values, volume.origin, volume.spacing, None)
    cells = volume.receivers.as_cells()
    return _cropped(
        cells.places().long(), cells.extinction, cells.origin, cells.spacing, _emission(volume.to_order(order))
    )


def _cropped(
    places: Int[Tensor, "K 3"],
    extinction: Float[Tensor, "K"],
    origin: object,
    spacing: object,
    emission: Emission | None,
) -> ThroughVolume:
    low = places.amin(0)
    size = torch.as_tensor(spacing, dtype=torch.float64)
    corner = torch.as_tensor(origin, dtype=torch.float64) + low * size
    inside = (places - low + 1).unbind(1)
    shape = (places.amax(0) - low + 3).tolist()
    dense = torch.zeros(shape)
    dense[inside] = extinction.to(torch.float32)
    number = torch.full(shape, len(places), dtype=torch.int32)
    number[inside] = torch.arange(len(places), dtype=torch.int32)
    return ThroughVolume(corner, size, dense, number, emission)


def _emission(transfer: Transfer) -> Emission:
    """The table of all cells, of the layers of a transfer."""
    tables, channels = [], 1
    for layer in transfer.layers.values():
        values = layer.signal.dense().laid_out(True).values.to(torch.float32)
        coloured = bool((layer.weight != layer.weight[:, :1]).any())
        channels = max(channels, len(values), 3 if coloured else 1)
        moments = torch.tensor(getattr(layer, "moments", [1.0]))
        band = torch.repeat_interleave(moments, torch.arange(1, 2 * len(moments), 2))
        weight = layer.weight.to(torch.float32)
        weight = weight if coloured else weight[:, :1]
        tables.append(((values * band[:, None]).permute(1, 2, 0, 3), weight, layer.index(transfer.vertices)))
    if len(tables) != 1:
        raise InputError(f"volume has {len(tables)} layers, where one of cells sends light: give what was baked of it")
    ((values, weight, index),) = tables
    table = torch.zeros(transfer.vertices + 1, values.shape[1], channels, values.shape[3])
    table[index] = values.expand(-1, -1, channels, -1) * weight[:, None, :, None]
    return Emission(table.flatten(2), channels)
